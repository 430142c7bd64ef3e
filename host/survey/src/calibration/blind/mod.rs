//! Self-calibration: errors of the sensors from a capture of any load, without a reference.
//!
//! Between two edges the bridge's voltage is constant, so that the voltages of coil and resonance capacitor add up to a
//! plateau: v = level − (1/C) ∫i dt. A current that is sampled late, or goes through a slow probe, adds a term of i to that of
//! ∫i; one with droop a term of ∬i. A regression gives 1/C and these terms with their standard deviations. The residuals decide
//! which kind of fault they mean, and whether the model holds.
//!
//! ```text
//! capture ─► stretch ─► phase of the bridge, edges ─► plateaus as polynomials ─► fit of each model ─► the best ─► correction
//!                       edges.rs                      plateau.rs, basis.rs       fit.rs               choose.rs   correction.rs
//! ```
//!
//! Two things cannot be separated: the gains from C, and a resistance r of the bridge from a lag of r·C.

mod basis;
mod calibrated_capture;
mod charge;
mod choose;
mod correction;
mod edges;
mod error;
mod estimate;
mod fit;
mod plateau;
mod remarks;
mod samples;
mod self_calibration;
mod settle;
mod straighten;
#[cfg(test)]
mod tests;

pub use self::calibrated_capture::{
    BlindOptions, CalibratedCapture, CalibrationMode, calibrate, calibrate_surveyed,
};
pub use self::correction::Correction;
pub use self::error::BlindError;
pub use self::estimate::{estimate, estimate_segment};
pub use self::fit::FittedValue;
pub use self::self_calibration::{
    BRIDGE_R_MAX_OHM, MAX_GAIN_OFF, ModelTests, SelfCalibration, SensorResponse,
};
pub use self::straighten::Saturation;
