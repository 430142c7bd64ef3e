//! The trainer: asks a hob for power, identifies its load from the windows it streams, and teaches
//! it the lookup.
//!
//! One operating point after the other: ask for power, wait until the frequency stays, take a
//! window, identify R(t) and L(t) with the PINN, let the gate decide, add the load curve to the
//! lookup, push it, wait until the device says it is active. Recorded half-cycles can stand for the
//! heating: they are replayed through the device, which records its windows from them.

mod error;
mod gate;
mod point;
mod run;
mod session;
mod source;

pub use error::TrainerError;
pub use gate::{GateVerdict, judge};
pub use ihd_pinn::Config as NetworkConfig;
pub use point::{LoadAt, Point};
pub use run::{Report, Settings, run};
pub use session::{Progress, TruthSource};
pub use source::{OperatingPoint, Recorded, Source};
