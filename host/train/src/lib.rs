//! What a hob's windows teach: the network on each, the lookup of all, the run that asks a hob for them; and
//! replay, which runs recorded samples through a device's own firmware.
//!
//! ```text
//! device ─► Window ─► Segment ─► network ─► gate ─► Curve ─► PotMap ─► lookup ─► device
//!           (link)    (link)     learning/ ─────────────────► (map)    lookup/   trainer/device.rs
//! ```
//!
//! [`Learning`] is what is known of one device; the daemon and the run share it. A run takes one operating
//! point after the other: ask for power, wait until the frequency stays, take a window, identify R(t) and
//! L(t) with the PINN, let the gate decide, add R and L over current to what is known of the pot, build the lookup, push
//! it, wait until the device reports it active. Recorded half-cycles can stand for the heating: they are
//! replayed through the device, which records its windows from them.

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
    Failed, NetworkConfig, OperatingPoint, Point, Progress, Recorded, Report, SETTLE_WITHIN,
    SETTLED_AFTER, Settings, Source, TrainerError, TruthSource, WINDOWS_EVERY, run,
};
