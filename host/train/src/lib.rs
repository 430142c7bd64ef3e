//! The trainer: asks a hob for power, identifies its load from the windows it streams, and updates its
//! lookup; and replay, which runs recorded samples through a device's own firmware.
//!
//! ```text
//! device ─► Window ─► Segment ─► network ─► gate ─► LoadCurve ─► Observations ─► lookup ─► device
//!           (link)    (link)                trainer/  network.rs  gate.rs point.rs  observations.rs  device.rs
//! ```
//!
//! One operating point after the other: ask for power, wait until the frequency stays, take a
//! window, identify R(t) and L(t) with the PINN, let the gate decide, add the load curve to what was
//! observed, build the lookup, push it, wait until the device reports it active. Recorded half-cycles
//! can stand for the heating: they are replayed through the device, which records its windows from
//! them.

pub mod lookup;
pub mod replay;
#[cfg(feature = "pinn")]
mod trainer;

#[cfg(feature = "pinn")]
pub use trainer::{
    GateVerdict, NetworkConfig, OperatingPoint, Point, Progress, Recorded, Report, Settings,
    Source, TrainerError, TruthSource, judge, run,
};
