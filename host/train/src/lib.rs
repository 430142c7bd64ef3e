//! The trainer: asks a hob for power, identifies its load from the windows it streams, and teaches
//! it the lookup.
//!
//! One operating point after the other: ask for power, wait until the frequency stays, take a
//! window, identify R(t) and L(t) with the PINN, let the gate decide, add the load curve to the
//! lookup, push it, wait until the device says it is active. Recorded half-cycles can stand for the
//! heating: they are replayed through the device, which records its windows from them.

#[cfg(feature = "pinn")]
mod error;
#[cfg(feature = "pinn")]
mod gate;
pub mod lookup;
#[cfg(feature = "pinn")]
mod point;
pub mod replay;
#[cfg(feature = "pinn")]
mod run;
#[cfg(feature = "pinn")]
mod session;
#[cfg(feature = "pinn")]
mod source;

#[cfg(feature = "pinn")]
pub use ihd_pinn::Config as NetworkConfig;

#[cfg(feature = "pinn")]
pub use self::{
    error::TrainerError,
    gate::{GateVerdict, judge},
    point::Point,
    run::{Report, Settings, run},
    session::{Progress, TruthSource},
    source::{OperatingPoint, Recorded, Source},
};
