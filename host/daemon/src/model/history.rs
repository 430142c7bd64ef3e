//! What a device did, over minutes to months.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A quantity in columns: the least, the mean and the largest of each; none where nothing is known of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Envelope {
    /// The least of each column.
    pub min: Vec<Option<f64>>,
    /// The mean of each column, over its half-cycles.
    pub mean: Vec<Option<f64>>,
    /// The largest of each column.
    pub max: Vec<Option<f64>>,
}

/// Telemetry of a stretch of time in at most as many columns as were asked for. All lists but those of
/// [`HistoryResults`] are equally long; a column in which the device was silent is left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct History {
    /// Where the stretch begins, in milliseconds since 1970, UTC.
    pub from_ms: i64,
    /// Where it ends.
    pub to_ms: i64,
    /// Width of a column in milliseconds.
    pub step_ms: i64,
    /// Where each column begins, in milliseconds since 1970, UTC.
    pub at_ms: Vec<i64>,
    /// Half-cycles in each column.
    pub half_cycles: Vec<u32>,
    /// Mean power of a half-cycle, in watt.
    pub power_w: Envelope,
    /// The device's own R at the current's crest, in ohm; none while it does not heat.
    pub r_ohm: Envelope,
    /// The device's own L at the current's crest, in henry; none while it does not heat.
    pub l_h: Envelope,
    /// Switching frequency in hertz; none while it does not heat.
    pub f_sw_hz: Envelope,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: Envelope,
    /// Phase of the inverter's voltage before its current at the crest, in degree, from mean R, L and f_sw and the
    /// resonance capacitor: positive above resonance. None while it does not heat.
    pub phase_deg: Vec<Option<f64>>,
    /// Resonance frequency with the mean L, in hertz; none while it does not heat.
    pub resonance_hz: Vec<Option<f64>>,
    /// Power that was asked for, in watt, last of the column.
    pub asked_w: Vec<u16>,
    /// The controller's state at the end of the column, in the words of [`super::Live::state`].
    pub state: Vec<String>,
    /// What stood on the coil at the end of the column, in the words of [`super::Live::pot`].
    pub pot: Vec<String>,
    /// Number of a fault in the column, 0 for none.
    pub fault: Vec<u16>,
    /// What the network said in this stretch.
    pub results: HistoryResults,
}

/// Results of the network in a stretch of time, oldest first; thinned evenly where there are more than columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HistoryResults {
    /// Results in the stretch; more than are listed where they were thinned.
    pub of: u64,
    /// When each one's window was stored, in milliseconds since 1970, UTC; a result is in the stretch when it came itself.
    pub at_ms: Vec<i64>,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: Vec<Option<f64>>,
    /// The same of L, in henry.
    pub l_h: Vec<Option<f64>>,
    /// Standard deviation of R in percent.
    pub sigma_r_pct: Vec<Option<f64>>,
    /// Standard deviation of L in percent.
    pub sigma_l_pct: Vec<Option<f64>>,
    /// Whether the gate let each pass.
    pub pass: Vec<bool>,
}
