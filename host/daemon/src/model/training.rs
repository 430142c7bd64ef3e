//! How the network came to what it says.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A step of the optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FitStep {
    /// Its number, from 1.
    pub step: u32,
    /// The loss.
    pub loss: f64,
    /// Mean relative change of R and L (the larger) over the last few steps, 0.01 being 1 %; none for the first few.
    pub change: Option<f64>,
}

/// What somebody remarks on a window or its result, in the codes of docs/gate.md.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FitRemark {
    /// Its code.
    pub code: String,
    /// `info`, `warning` or `error`.
    pub severity: String,
    /// In words.
    pub text: String,
}

/// A window that was learned from, or refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Fit {
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// When the result was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: Option<f64>,
    /// The same of L, in henry.
    pub l_h: Option<f64>,
    /// Standard deviation of R in percent.
    pub sigma_r_pct: Option<f64>,
    /// Standard deviation of L in percent.
    pub sigma_l_pct: Option<f64>,
    /// Whether the gate let it pass.
    pub pass: bool,
    /// Why not; empty where it did.
    pub why: String,
    /// What was remarked on it; empty for fits of before the daemon's start.
    pub remarks: Vec<FitRemark>,
    /// Whether the lookup is another one for it.
    pub changed_lookup: bool,
    /// Steps of the optimiser.
    pub iterations: u32,
    /// Seconds that it took; none for fits of before the daemon's start.
    pub seconds: Option<f64>,
    /// Its steps; empty for fits of before the daemon's start.
    pub steps: Vec<FitStep>,
    /// Error of R against the truth, in percent of it, where the device is simulated in the daemon itself.
    pub r_error_pct: Option<f64>,
    /// The same of L.
    pub l_error_pct: Option<f64>,
}
