//! Judgement of estimates: decides whether R(t) and L(t) can be trusted, and says why not. `ihd identify`, the studies,
//! the trainer and the lookup share it.
//!
//! ```text
//! Capture ─► repaired, neighbours removed ─► survey ─► segments ─► methods ─► Estimate ──┐
//!                                   └─► Reference: least squares,   ├─► judge ─► findings, Gate { pass | refuse | cannot tell, why }
//!                                       lock-in, foreign tones ────┘
//! ```
//!
//! A finding of severity error refuses the estimate; `too_short` leaves it open; nothing else does. Each half-cycle has its own verdict. All codes are in [`codes::CODES`].
//! [`claim::confirm`] checks R(t) and L(t) that another machine states, without a fit of its own.

pub mod claim;
pub mod codes;
pub mod comparison;
pub mod interference;
pub mod joint;
pub mod judge;
pub mod limits;
pub mod lines;
pub mod neighbours;
pub mod path;
mod prepared;
pub mod reference;
pub mod remarks;
pub mod repair;
pub mod sensors;
pub mod static_load;
pub mod verdict;

pub use judge::{Evidence, judge};
pub use path::{
    Examination, ExamineOptions, MethodResult, OnProgress, Reconstruct, examine, examine_taking,
};
pub use reference::ReferenceResults;
pub use verdict::{Gate, HalfCycleVerdict, Judgement, Verdict, VerdictTally};
