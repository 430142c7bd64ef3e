//! Whether R(t) and L(t) can be trusted, and why not: one judge for `ihd identify`, the studies, the trainer and
//! the lookup.
//!
//! ```text
//! Capture ─► survey ─► segments ─► methods ─► Estimate ─┐
//!                         └─► Witness: least squares,    ├─► judge ─► findings, Gate { pass | refuse, why }
//!                             lock-in, foreign tones ───┘
//! ```
//!
//! A finding of severity error refuses, and nothing else does. Every code stands in [`codes::CODES`].

pub mod claim;
pub mod codes;
pub mod comparison;
pub mod interference;
pub mod judge;
pub mod lines;
pub mod path;
pub mod remarks;
pub mod sensors;
pub mod static_load;
pub mod verdict;
pub mod witness;

pub use judge::{Evidence, judge};
pub use path::{Examined, Outcome, Reconstruct, Request, examine};
pub use verdict::{Gate, Judgement, Verdict};
pub use witness::Witness;
