//! How warm a pot is, as far as R and L tell.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How much warmer a pot is than when it was put on. Never an absolute temperature, never an input of protection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotTemperature {
    /// When the pot was put on, or the daemon met it: ΔT is 0 there. Milliseconds since 1970, UTC.
    pub since_ms: i64,
    /// Rise of the base's temperature since then, in kelvin.
    pub rise_k: f64,
    /// Its standard deviation in kelvin, the unknown alloy included.
    pub sigma_k: f64,
    /// Lift since then, in mm.
    pub lift_mm: f64,
    /// Its standard deviation in mm.
    pub lift_sigma_mm: f64,
    /// The base is on its plateau: bubbles carry most of the heat.
    pub bubbles: bool,
    /// All of the contents boil.
    pub boils: bool,
    /// Nothing with water in it is so much warmer than it was.
    pub overheats: bool,
}

/// A point of the curve of ΔT.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotPoint {
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Rise in kelvin.
    pub rise_k: f64,
    /// Its standard deviation in kelvin.
    pub sigma_k: f64,
}

/// ΔT of the pot that stands on a device's coil, since it was put on: the last hour, a point every two seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotCurve {
    /// What is known now; none before a pot is.
    pub now: Option<PotTemperature>,
    /// Oldest first.
    pub points: Vec<PotPoint>,
}
