//! Errors of a self-calibration.

use crate::{Channel, Finding};

/// Reason why a capture does not show its sensors.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BlindError {
    /// Another fault has to be removed first.
    #[error("the sensors cannot be judged: {0}")]
    Unfit(Finding),
    /// No edges were found.
    #[error(
        "the sensors cannot be judged: no edges of a bridge stand out in the voltage, as of a sine or at too low a rate"
    )]
    NoEdges,
    /// Too few samples between the edges.
    #[error(
        "the sensors cannot be judged: {plateaus} stretches between edges have samples enough; capture longer or at a higher \
         rate"
    )]
    TooFew {
        /// Number of usable plateaus.
        plateaus: usize,
    },
    /// The voltage itself is constant between edges: it is the bridge's.
    #[error(
        "the voltage does not follow the charge between edges: this is the bridge's voltage, not the coil's, and R and L \
         would contain the resonance capacitor; connect the probe across the coil"
    )]
    BridgeVoltage,
    /// Few levels: their rounding is no noise, and looks like a lag.
    #[error(
        "the sensors cannot be judged: the {channel} has steps of {step:.3}, {of_rms_pct:.0} % of its rms; use more bits or a smaller range"
    )]
    TooCoarse {
        /// Channel with the steps.
        channel: Channel,
        /// Distance of its levels, in its unit.
        step: f64,
        /// The same in percent of its rms value.
        of_rms_pct: f64,
    },
    /// Noise hides the capacitor's voltage.
    #[error(
        "the sensors cannot be judged: noise hides the capacitor's voltage ({per_farad:.0} ± {sigma:.0} 1/F)"
    )]
    TooNoisy {
        /// Estimated 1/C in 1/farad.
        per_farad: f64,
        /// Standard deviation of `per_farad`.
        sigma: f64,
    },
}
