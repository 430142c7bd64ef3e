//! What only the API says; the rest is [`ihd_daemon::model`].

use std::collections::BTreeMap;

use ihd_daemon::model::{CommandError, StoreFailure};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::access::Role;

/// Header that names who asks: 1 to 64 printable ASCII characters. It is told to others, and proves nothing.
pub const HOLDER_HEADER: &str = "ihd-holder";

/// Who holds or wants the lease of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    /// Take it from whoever has it.
    #[serde(default)]
    pub force: bool,
}

/// A token that a browser shows once. It has no `Debug`: it belongs in no message.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionRequest {
    /// A token of the token file.
    pub token: String,
}

/// What whoever asks may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SessionReport {
    /// The highest role that he has.
    pub role: Role,
    /// Whether the daemon wants tokens at all.
    pub token_needed: bool,
    /// Whether it is an edge of a fleet, of which `/fleet` tells.
    #[serde(default)]
    pub fleet: bool,
}

/// Where a backup goes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BackupRequest {
    /// Name of a folder or file that does not exist yet, in the folder `backups` of the store.
    pub to: String,
}

/// A backup that was made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BackupMade {
    /// Its path on the daemon's machine.
    pub path: String,
}

/// A result of the store: what one window taught. Numbers that came out as none are left empty.
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
    /// Mean power, in watt, where it was known.
    pub power_w: Option<f64>,
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
    /// Whether the lookup is another one for it.
    pub changed_lookup: bool,
}

/// A lookup of the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoredLookup {
    /// Its version.
    pub version: u32,
    /// `pending`, `active`, `superseded` or `refused`.
    pub state: String,
    /// Milliseconds since 1970, UTC, of its last change of state.
    pub at_ms: i64,
    /// Who built it: `host`, or `device` where it was found there.
    pub origin: String,
    /// Why it was built, or refused.
    pub why: String,
    /// Its bytes ([`ihd_daemon::model::Command::LookupPush`] takes them).
    pub blob: Vec<u8>,
}

/// Whether the daemon works.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// Always `ihd`: how the command knows that it found a daemon.
    pub service: String,
    /// Whether the store takes what it is given.
    pub store: bool,
    /// Why it does not, since when, what was dropped since then, and what to do; `null` while it does.
    #[serde(default)]
    pub store_failure: Option<StoreFailure>,
    /// Whether devices are looked after.
    pub supervisor: bool,
    /// All commands so far are in the audit, or on their way to it.
    pub audit: bool,
}

/// What a watcher that reads too slowly has missed; the event `missed`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Missed {
    /// Notices that were dropped for this watcher.
    pub missed: u64,
}

/// Why a request was not carried out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// A word to branch on: `no-device`, `leased`, `role`, …
    pub error: String,
    /// What was wrong and what to do, for a person.
    pub message: String,
    /// What else belongs to the error: `holder`, `expires_in_s`, …
    #[serde(flatten)]
    pub fields: BTreeMap<String, serde_json::Value>,
}

impl Problem {
    /// A problem without further fields.
    pub fn new(error: &str, message: impl Into<String>) -> Self {
        Self {
            error: error.into(),
            message: message.into(),
            fields: BTreeMap::new(),
        }
    }

    /// The daemon's own error, where it is one.
    pub fn command_error(&self) -> Option<CommandError> {
        serde_json::from_value(serde_json::to_value(self).ok()?).ok()
    }
}

impl From<&CommandError> for Problem {
    fn from(error: &CommandError) -> Self {
        let mut fields = match serde_json::to_value(error) {
            Ok(serde_json::Value::Object(fields)) => fields,
            _ => serde_json::Map::new(),
        };
        let word = match fields.remove("error") {
            Some(serde_json::Value::String(word)) => word,
            _ => "failed".into(),
        };
        Self {
            error: word,
            message: error.to_string(),
            fields: fields.into_iter().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_daemon_survives_the_way_to_the_client() {
        let error = CommandError::Leased {
            name: "bench".into(),
            holder: "Ada".into(),
            expires_in_s: 7,
        };
        let sent = serde_json::to_string(&Problem::from(&error)).unwrap();
        let problem: Problem = serde_json::from_str(&sent).unwrap();
        assert_eq!(problem.error, "leased");
        assert_eq!(problem.message, error.to_string());
        assert_eq!(problem.command_error(), Some(error));
    }

    #[test]
    fn a_refusal_of_the_server_is_no_error_of_the_daemon() {
        assert_eq!(Problem::new("role", "no").command_error(), None);
    }
}
