//! Live telemetry: devices' values since a subscriber's last request.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::device::Live;

/// Telemetry since a subscriber's last request, of the devices that sent any, by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveTelemetry {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Telemetry of each device.
    pub devices: BTreeMap<String, LiveDevice>,
}

/// Telemetry of a device since a subscriber's last request. Extremes are `[minimum, maximum]`; they may reach 0.1 s further
/// back than the counted half-cycles, and at most a minute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveDevice {
    /// Number of half-cycles received.
    pub half_cycles: u64,
    /// Number of intervals that the subscriber did not fetch in time; their extremes are included here.
    pub skipped: u32,
    /// The last half-cycle.
    pub last: Live,
    /// Phase by which the inverter's voltage leads its current at the crest, in degree: positive above resonance.
    /// From R, L and f_sw of the last half-cycle; `None` while it does not heat.
    pub phase_deg: Option<f64>,
    /// Resonance frequency at the last L, in hertz; `None` while it does not heat.
    pub resonance_hz: Option<f64>,
    /// Mean power of a half-cycle, in watt.
    pub power_w: [f64; 2],
    /// The device's estimate of R at the current's crest, in ohm; `None` while it does not heat.
    pub r_ohm: Option<[f64; 2]>,
    /// The device's estimate of L at the current's crest, in henry; `None` while it does not heat.
    pub l_h: Option<[f64; 2]>,
    /// Switching frequency in hertz; `None` while it does not heat.
    pub f_sw_hz: Option<[f64; 2]>,
}
