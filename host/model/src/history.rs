//! History of a device: telemetry and results over minutes to months.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Minimum, mean and maximum of a quantity in each column; `None` if the quantity is unknown there.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Envelope {
    /// Minimum in each column.
    pub min: Vec<Option<f64>>,
    /// Mean over the half-cycles of each column.
    pub mean: Vec<Option<f64>>,
    /// Maximum in each column.
    pub max: Vec<Option<f64>>,
}

/// Telemetry of a time range in at most the requested number of columns. All lists except those of
/// [`HistoryResults`] have the same length; columns without telemetry are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct History {
    /// Start of the range, in milliseconds since 1970, UTC.
    pub from_ms: i64,
    /// End of the range, in milliseconds since 1970, UTC.
    pub to_ms: i64,
    /// Width of a column in milliseconds.
    pub step_ms: i64,
    /// Start of each column, in milliseconds since 1970, UTC.
    pub at_ms: Vec<i64>,
    /// Number of half-cycles in each column.
    pub half_cycles: Vec<u32>,
    /// Mean power of a half-cycle, in watt.
    pub power_w: Envelope,
    /// The device's estimate of R at the current's crest, in ohm; `None` while it does not heat.
    pub r_ohm: Envelope,
    /// The device's estimate of L at the current's crest, in henry; `None` while it does not heat.
    pub l_h: Envelope,
    /// Switching frequency in hertz; `None` while it does not heat.
    pub f_sw_hz: Envelope,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: Envelope,
    /// Phase by which the inverter's voltage leads its current at the crest, in degree, from mean R, L and f_sw and the
    /// resonance capacitor: positive above resonance. `None` while it does not heat.
    pub phase_deg: Vec<Option<f64>>,
    /// Resonance frequency at the mean L, in hertz; `None` while it does not heat.
    pub resonance_hz: Vec<Option<f64>>,
    /// Last requested power of the column, in watt.
    pub asked_w: Vec<u16>,
    /// State of the controller at the end of the column, as in [`crate::Live::state`].
    pub state: Vec<String>,
    /// Pot on the coil at the end of the column, as in [`crate::Live::pot`].
    pub pot: Vec<String>,
    /// Number of a fault in the column; 0 if there was none.
    pub fault: Vec<u16>,
    /// Results of the network in this range.
    pub results: HistoryResults,
}

/// Results of the network in a time range, oldest first; thinned evenly if there are more results than columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HistoryResults {
    /// Number of results in the range; larger than the lists if they were thinned.
    pub of: u64,
    /// Time at which each result's window was stored, in milliseconds since 1970, UTC. A result counts by the time at which it was stored itself.
    pub at_ms: Vec<i64>,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: Vec<Option<f64>>,
    /// Mean of L weighted with the squared current, in henry.
    pub l_h: Vec<Option<f64>>,
    /// Standard deviation of R in percent.
    pub sigma_r_pct: Vec<Option<f64>>,
    /// Standard deviation of L in percent.
    pub sigma_l_pct: Vec<Option<f64>>,
    /// `true` for each result that passed the gate.
    pub pass: Vec<bool>,
}
