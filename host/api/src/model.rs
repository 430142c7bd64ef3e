//! Messages of the API itself; those of the daemon are in [`ihd_daemon::model`].

use std::collections::BTreeMap;

use ihd_daemon::model::{CommandError, StoreFailure};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::access::role::Role;

/// Header with the name of the client: 1 to 64 printable ASCII characters. It is shown to other clients and is not authenticated.
pub const HOLDER_HEADER: &str = "ihd-holder";

/// Request for the lease of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    /// Revoke the lease of another holder.
    #[serde(default)]
    pub force: bool,
}

/// Token that opens a browser session.
// No `Debug`: a token must not appear in a message.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionRequest {
    /// Token from the token file.
    pub token: String,
}

/// Rights of the client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SessionReport {
    /// Highest role of the client.
    pub role: Role,
    /// `true` if the daemon requires tokens.
    pub token_needed: bool,
    /// `true` if the daemon is an edge of a fleet, which `/fleet` reports.
    #[serde(default)]
    pub fleet: bool,
}

/// Request for a backup.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BackupRequest {
    /// Name of the backup in the folder `backups` of the store; must not exist yet.
    pub to: String,
}

/// Finished backup.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BackupMade {
    /// Path on the daemon's machine.
    pub path: String,
}

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
    /// Bytes, as in [`ihd_daemon::model::Command::LookupPush`].
    pub blob: Vec<u8>,
}

/// Health of the daemon.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// Always `ihd`; identifies the daemon.
    pub service: String,
    /// `true` while the store accepts records.
    pub store: bool,
    /// Failure of the store, with its cause, its time, the records lost since then and advice; `null` while there is none.
    #[serde(default)]
    pub store_failure: Option<StoreFailure>,
    /// `true` while devices are supervised.
    pub supervisor: bool,
    /// `true` while all commands so far are in the audit or queued for it.
    pub audit: bool,
}

/// Data of the event `missed`: the client reads too slowly.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MissedEvents {
    /// Number of events that were dropped for this subscriber.
    pub missed: u64,
}

/// Error of a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// Error code: `no-device`, `leased`, `role`, …
    pub error: String,
    /// Description of the error and advice, for users.
    pub message: String,
    /// Further fields of the error: `holder`, `expires_in_s`, …
    #[serde(flatten)]
    pub fields: BTreeMap<String, serde_json::Value>,
}

impl Problem {
    /// Creates a problem without further fields.
    pub fn new(error: &str, message: impl Into<String>) -> Self {
        Self {
            error: error.into(),
            message: message.into(),
            fields: BTreeMap::new(),
        }
    }

    /// Returns the daemon's error; `None` if the server itself refused the request.
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
        let code = match fields.remove("error") {
            Some(serde_json::Value::String(code)) => code,
            _ => "failed".into(),
        };
        Self {
            error: code,
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
