//! Learning from the windows of all devices: a queue, threads that train, and what they found.
//!
//! ```text
//! offer ─► Queue (bounded, a turn a device) ─► threads: Learning::observe ─► Learned (bounded channel)
//!          queue.rs                             learner.rs                    outcome.rs
//! ```
//!
//! Every window of a heating device teaches, settled or not: a window holds one switching frequency
//! throughout (the firmware discards one in which it changes), and R and L over current at a frequency do not
//! depend on what the power control is about to do next. Windows of a hob that probes, or that carry too little
//! current to tell R and L from noise, are refused by the gate.

mod answer;
mod answers;
mod figures;
mod learner;
mod outcome;
mod queue;
#[cfg(test)]
mod tests;

use ihd_shared::wire::messages::{State, Telemetry};

pub use self::answer::{Answer, Stated, power_w};
pub use self::answers::{Standing, WorkerFigures};
pub use self::figures::LearnerFigures;
pub use self::learner::{InUse, Learner, LearnerError, LearnerSettings};
pub use self::outcome::{Course, Learned, Lookup, Numbers, Task, Work, curve_of};
pub use self::queue::Dropped;

/// Whether the windows of a device that says this are worth learning from.
pub fn teaches(telemetry: &Telemetry) -> bool {
    telemetry.state == State::Heating
}
