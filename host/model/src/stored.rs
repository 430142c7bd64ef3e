//! Results and lookups in the store.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Stored result of one window. Numbers are `null` if they are not finite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StoredResult {
    /// Name of the device.
    pub device: String,
    /// Boot of the device.
    pub boot: u32,
    /// Number of the window since that boot.
    pub seq: u32,
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Half-cycle of the window since that boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: Option<f64>,
    /// Mean power in watt; `null` if unknown.
    pub power_w: Option<f64>,
    /// Mean of R, weighted with the squared current, in ohm.
    pub r_ohm: Option<f64>,
    /// Mean of L, weighted with the squared current, in henry.
    pub l_h: Option<f64>,
    /// Standard deviation of R in percent.
    pub sigma_r_pct: Option<f64>,
    /// Standard deviation of L in percent.
    pub sigma_l_pct: Option<f64>,
    /// `true` if the gate accepted the window.
    pub pass: bool,
    /// Reason for which the gate rejected it; empty if it did not.
    pub why: String,
    /// `true` if the window changed the lookup.
    pub changed_lookup: bool,
}

/// Stored lookup.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoredLookup {
    /// Version.
    pub version: u32,
    /// `pending`, `active`, `superseded` or `refused`.
    pub state: String,
    /// Time of its last change of state, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Origin: `host`, or `device` if it was read from there.
    pub origin: String,
    /// Reason for which it was built or refused.
    pub why: String,
    /// Bytes, as in [`crate::Command::LookupPush`].
    pub blob: Vec<u8>,
}
