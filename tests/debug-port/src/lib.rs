//! A debug probe and an STM32G474 without a processor, for tests of what flashes and reads a board.

pub mod chip;
pub mod cortex_m;
pub mod port;
#[cfg(feature = "probe")]
pub mod probe;
pub mod target;

pub use chip::Chip;
pub use target::{BusFault, Contact, Stop, Target};
