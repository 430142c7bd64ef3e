//! Protect: checks of each block that act at once, whatever link or lookup say.
//!
//! | level | coil current | reaction | where |
//! |---|---|---|---|
//! | soft limit | 73 A | raises the frequency within a block | [`soft_limit`] |
//! | trip | 76 A | opens both switches within a block | [`trips`] |
//! | comparator | 76 A | opens both switches in hardware, before either of them | the board |
//!
//! The other quantities (bus, resonance, turn-off current, estimate, lost samples) stand in the two modules; all levels stand
//! in [`crate::limits`]. A trip stays in the [`fault_latch`] until it is cleared.

pub mod fault_latch;
pub mod soft_limit;
pub mod trips;
