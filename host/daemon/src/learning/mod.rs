//! Learning from the windows of all devices: a queue, threads that identify, and their results.
//!
//! ```text
//! offer ─► Queue ─► threads ─► identify ─► settle ─► LearnResult ─► store, device
//!          bounded,            the network, notes of the            (result_route.rs)
//!          devices in turn     or a worker's device applied
//!                              answer
//! ```
//!
//! Every window of a heating device is learned from, settled or not. A window has one switching frequency throughout: the
//! firmware discards one in which it changes. R and L over current at a frequency do not depend on the next step of power
//! control. The gate refuses windows of a hob that probes, and those with too little current to separate R and L from noise.

mod answer;
mod figures;
mod fit;
mod fit_window;
mod job;
mod learner;
mod queue;
mod settle;
mod shared;
#[cfg(any(test, feature = "simulation"))]
mod simulated;
mod slot;
#[cfg(test)]
mod tests;
mod threads;
mod workers;

pub use self::answer::{StatedLoad, WorkerAnswer, power_w};
pub use self::figures::LearnerFigures;
pub use self::fit::{FitSummary, FitTrace, truth_curve};
pub use self::job::{LearnInput, LearnJob, LearnResult, LookupToPush};
pub use self::learner::{Learner, LearnerError, LearnerSettings, LearningInUse};
pub use self::queue::DroppedWindow;
pub(crate) use self::slot::LearnerSlot;
pub use self::workers::{AnswerVerdict, WorkerFigures, sum_answers};
