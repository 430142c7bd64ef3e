//! The lookup as a map over switching frequency and current.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A lookup in ohm and henry. Tables are `[frequency][current]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Map {
    /// Its version; 0 is the built-in prior.
    pub version: u32,
    /// `prior`, `pending`, `active`, `superseded` or `refused`.
    pub state: String,
    /// Milliseconds since 1970, UTC, of its last change of state; 0 for the prior.
    pub at_ms: i64,
    /// Who built it: `host`, `device` where it was found there, `firmware` for the prior.
    pub origin: String,
    /// Why it was built, or refused.
    pub why: String,
    /// Switching frequencies of the rows, in hertz.
    pub f_sw_hz: Vec<f64>,
    /// Amplitudes of the current's fundamental of the columns, in ampere.
    pub i_a: Vec<f64>,
    /// R in ohm.
    pub r_ohm: Vec<Vec<f64>>,
    /// L in henry.
    pub l_h: Vec<Vec<f64>>,
    /// Power at that amplitude, R I² / 2, in watt: over some switching periods, not over a mains half-cycle.
    pub power_w: Vec<Vec<f64>>,
    /// Whether the cell rests on observations.
    pub observed: Vec<Vec<bool>>,
    /// Confidence of each cell, 0 to 1; none where it is not known (a lookup of before the daemon's start).
    pub confidence: Option<Vec<Vec<f64>>>,
    /// Seconds since something near the cell was last learned from; none where never.
    pub age_s: Vec<Vec<Option<f64>>>,
}

/// What every hob of this build has, and the controller's limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Hob {
    /// Rated mean power over a mains half-cycle, in watt.
    pub rated_power_w: u16,
    /// Lowest switching frequency, in hertz.
    pub f_sw_min_hz: u32,
    /// Highest switching frequency, in hertz.
    pub f_sw_max_hz: u32,
    /// Series resonance capacitor, in farad.
    pub resonance_capacitance_f: f64,
    /// How far above the resonance frequency the controller stays at least, as a factor.
    pub resonance_margin: f64,
    /// Largest amplitude of the coil's current that the controller asks for, in ampere.
    pub i_limit_a: f64,
    /// How long a lease lasts, in seconds.
    pub lease_s: u32,
}
