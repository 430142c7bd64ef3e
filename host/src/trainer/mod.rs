//! The trainer: asks a hob for power, identifies its load from the windows it streams, and teaches
//! it the lookup.
//!
//! One operating point after the other: ask for power, wait until the frequency stays, take a
//! window, identify R(t) and L(t) with the PINN, let the gate decide, add the load curve to the
//! lookup, push it, wait until the device says it is active.

mod error;
mod gate;
mod point;
mod run;
mod session;

pub use error::TrainerError;
pub use gate::{GateVerdict, judge};
pub use point::{LoadAt, Point};
pub use run::{Report, Settings, run};
pub use session::{Progress, TruthSource};
