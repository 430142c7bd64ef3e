//! What devices did since a watcher last asked.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Live;

/// Telemetry since a watcher last asked: devices that were heard in between, by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveTelemetry {
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// What each did that was heard.
    pub devices: BTreeMap<String, LiveDevice>,
}

/// What a device did since a watcher last asked. Extremes are `[least, largest]`; they may reach 0.1 s further
/// back than the half-cycles that are counted, and reach back a minute at most.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveDevice {
    /// Half-cycles that were heard.
    pub half_cycles: u64,
    /// Intervals that the watcher was too slow for, whose extremes are in this one all the same.
    pub skipped: u32,
    /// The last half-cycle.
    pub last: Live,
    /// Phase of the inverter's voltage before its current at the crest, in degree: positive above resonance.
    /// From R, L and f_sw of the last half-cycle; none while it does not heat.
    pub phase_deg: Option<f64>,
    /// Resonance frequency with the last L, in hertz; none while it does not heat.
    pub resonance_hz: Option<f64>,
    /// Mean power of a half-cycle, in watt.
    pub power_w: [f64; 2],
    /// The device's own R at the current's crest, in ohm; none while it does not heat.
    pub r_ohm: Option<[f64; 2]>,
    /// The device's own L at the current's crest, in henry; none while it does not heat.
    pub l_h: Option<[f64; 2]>,
    /// Switching frequency in hertz; none while it does not heat.
    pub f_sw_hz: Option<[f64; 2]>,
}
