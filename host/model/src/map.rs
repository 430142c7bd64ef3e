//! Lookup as a map over switching frequency and current.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Lookup in ohm and henry. Tables are `[frequency][current]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Map {
    /// Version; 0 is the built-in prior.
    pub version: u32,
    /// `prior`, `pending`, `active`, `superseded` or `refused`.
    pub state: String,
    /// Time of its last change of state, in milliseconds since 1970, UTC; 0 for the prior.
    pub at_ms: i64,
    /// Origin: `host`, `device` if it was read from there, `firmware` for the prior.
    pub origin: String,
    /// Reason why it was built, or refused.
    pub why: String,
    /// Switching frequencies of the rows, in hertz.
    pub f_sw_hz: Vec<f64>,
    /// Amplitudes of the current's fundamental of the columns, in ampere.
    pub i_a: Vec<f64>,
    /// R at that amplitude, in ohm.
    pub r_ohm: Vec<Vec<f64>>,
    /// L at that amplitude, in henry.
    pub l_h: Vec<Vec<f64>>,
    /// P: mean power over a mains half-cycle whose voltage follows |sin| up to that at this amplitude, in watt.
    pub power_w: Vec<Vec<f64>>,
    /// `true` for cells that rest on observations.
    pub observed: Vec<Vec<bool>>,
    /// Standard deviation of R of each cell in percent of R, as it was when the lookup was built; `None` if unknown (pushed by hand, or
    /// built by an earlier version).
    pub sigma_r_pct: Option<Vec<Vec<f64>>>,
    /// Standard deviation of L, likewise.
    pub sigma_l_pct: Option<Vec<Vec<f64>>>,
    /// Confidence of each cell: from 0, no window has measured it, to 1, many have; `None` if unknown.
    pub confidence: Option<Vec<Vec<f64>>>,
    /// Seconds since the window of the last accepted result near the cell; `None` if there was none, or none of this lookup's pot.
    pub age_s: Vec<Vec<Option<f64>>>,
}

/// Ratings of every hob of this build, and limits of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Hob {
    /// Rated mean power over a mains half-cycle, in watt.
    pub rated_power_w: u16,
    /// Largest power that may be requested, in watt; above the rating the hob takes its rating.
    pub requested_power_max_w: u16,
    /// Lowest switching frequency, in hertz.
    pub f_sw_min_hz: u32,
    /// Highest switching frequency, in hertz.
    pub f_sw_max_hz: u32,
    /// Capacitance that resonates with the load, in farad: the resonance capacitor, and the bus capacitor in series.
    pub resonance_capacitance_f: f64,
    /// Smallest ratio of switching to resonance frequency that the controller allows.
    pub resonance_margin: f64,
    /// Largest amplitude of the coil's current that the controller requests, in ampere.
    pub i_limit_a: f64,
    /// Duration of a lease in seconds.
    pub lease_s: u32,
}
