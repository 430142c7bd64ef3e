//! From a window to the lookup on the device, and replay of a capture through a device's own firmware.
//!
//! ```text
//! device ─► Window ─► Segment ─► network ─► gate ─► CurrentCurve ─► PotMap ─► lookup ─► device
//!           (link)    (link)     learning/ ─────────────────► (map)    lookup/   trainer/device.rs
//! ```
//!
//! [`Learning`] is the state learned from one device; the daemon and the training run share it. A run, per operating point:
//!
//! 1. request a power and wait until the frequency is steady;
//! 2. receive a window;
//! 3. identify R(t) and L(t) with the network;
//! 4. let the gate decide;
//! 5. add R and L over current to the pot's map;
//! 6. build the lookup, push it, and wait until the device reports it active.
//!
//! Recorded half-cycles can replace the heating: they are replayed through the device, which records its windows from them.

#[cfg(feature = "pinn")]
pub mod learning;
pub mod limits;
pub mod lookup;
pub mod replay;
#[cfg(feature = "pinn")]
mod trainer;

#[cfg(feature = "pinn")]
pub use learning::{Learning, judge};
#[cfg(feature = "pinn")]
pub use trainer::{
    NetworkConfig, OperatingPoint, PointReport, RecordedHalfCycle, RunFailure, RunOptions,
    RunProgress, RunReport, SETTLE_WITHIN, Steadiness, TrainerError, TrainingSource, TruthSource,
    WINDOWS_EVERY, run,
};
