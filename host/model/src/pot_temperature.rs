//! Temperature rise of a pot, estimated from R and L.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Temperature rise of a pot since it was put on. Never an absolute temperature, never an input of protection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotTemperature {
    /// Time at which the pot was put on, or first observed; ΔT is 0 there. Milliseconds since 1970, UTC.
    pub since_ms: i64,
    /// Temperature rise of the base since then, in kelvin.
    pub rise_k: f64,
    /// Standard deviation of the rise in kelvin, including that of the unknown alloy.
    pub sigma_k: f64,
    /// Rise by the heat alone, without R and L, in kelvin.
    pub prior_k: f64,
    /// Standard deviation of the rise by the heat alone, in kelvin.
    pub prior_sigma_k: f64,
    /// Lift since then, in mm.
    pub lift_mm: f64,
    /// Standard deviation of the lift in mm.
    pub lift_sigma_mm: f64,
    /// `true` while the base is on its plateau: bubbles carry most of the heat.
    pub bubbles: bool,
    /// `true` while all of the contents boil.
    pub boils: bool,
    /// `true` while the rise is too large for a pot with water in it.
    pub overheats: bool,
}

/// Point of the curve of ΔT.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotPoint {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Rise in kelvin.
    pub rise_k: f64,
    /// Standard deviation of the rise in kelvin.
    pub sigma_k: f64,
}

/// ΔT of the pot on a device's coil since it was put on: the last hour, a point every two seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PotCurve {
    /// Current estimate; `None` before a pot is observed.
    pub now: Option<PotTemperature>,
    /// Points, oldest first.
    pub points: Vec<PotPoint>,
}
