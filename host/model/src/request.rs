//! Requests to the API itself, and their answers.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::role::Role;
use crate::store::StoreFailure;

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
    /// `true` while all commands so far are in the audit or queued for it.
    pub audit: bool,
}

/// Data of the event `missed`: the client reads too slowly.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MissedEvents {
    /// Number of events that were dropped for this subscriber.
    pub missed: u64,
}
