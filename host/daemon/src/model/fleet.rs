//! What a daemon that is an edge of a fleet knows of the whole (docs/fleet.md).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The fleet, as one edge or `ihd fleet status` sees it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetReport {
    /// Address of the server, without what is secret in it.
    pub server: String,
    /// Name of the edge that tells this; empty where it is none.
    pub edge: String,
    /// Whether the server answers; the numbers are those of `at_ms` where it does not.
    pub connected: bool,
    /// Why not, in words; empty where it does.
    pub why: String,
    /// When the numbers were true, in milliseconds since 1970, UTC; 0 where they never were.
    pub at_ms: i64,
    /// Windows and results in this edge's store that the fleet has not acknowledged yet.
    pub outbox: u64,
    /// Windows that the fleet has acknowledged, ever.
    pub windows: u64,
    /// Results in the fleet, each of another window.
    pub results: u64,
    /// Windows in the fleet that nobody has identified yet.
    pub backlog: u64,
    /// Windows that were given up, until somebody replays or deletes them.
    pub dead: u64,
    /// Who identifies.
    pub workers: Vec<FleetWorker>,
    /// Daemons with hobs.
    pub edges: Vec<FleetEdge>,
    /// Hobs, by name.
    pub devices: Vec<FleetDevice>,
}

/// A worker.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetWorker {
    /// Its name.
    pub name: String,
    /// Version of its ihd.
    pub version: String,
    /// Threads that identify.
    pub threads: u32,
    /// Windows that it is at.
    pub busy: u32,
    /// Windows that it has identified since it began.
    pub done: u64,
    /// Windows that it has failed at.
    pub failed: u64,
    /// When it was heard of last, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}

/// A daemon with hobs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetEdge {
    /// Its name.
    pub name: String,
    /// Version of its ihd.
    pub version: String,
    /// Windows and results in its store that the fleet has not acknowledged.
    pub outbox: u64,
    /// Whether it leaves its windows to the fleet now; else it learns by itself.
    pub trusts_fleet: bool,
    /// When it was heard of last, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}

/// A hob.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetDevice {
    /// Its name, unique in the site.
    pub name: String,
    /// The edge that it hangs on.
    pub edge: String,
    /// State, in the words of [`super::DeviceState`].
    pub state: String,
    /// What stands on the coil; empty where that is not known.
    pub pot: String,
    /// Its firmware's build; empty where it was never shaken hands with.
    pub build: String,
    /// Protocol, major and minor.
    pub protocol: (u16, u16),
    /// Version of its lookup.
    pub lookup_version: u32,
    /// Whether its build differs from the one that most hobs of its board have or `ihd fleet init --build` names.
    pub outdated: bool,
    /// When it was heard of last, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}
