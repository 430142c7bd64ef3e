//! State of a fleet, as an edge or `ihd-fleet status` reports it (docs/fleet.md).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// State of a fleet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetReport {
    /// Address of the server, without secrets.
    pub server: String,
    /// Name of the reporting edge; empty if the reporter is no edge.
    pub edge: String,
    /// `true` while the server answers; otherwise the numbers are those of `at_ms`.
    pub connected: bool,
    /// Reason why the server does not answer; empty if it does.
    pub why: String,
    /// Time at which the numbers of the whole fleet (`windows` to `edges`) were read, in milliseconds since 1970, UTC; 0 if they never were: the
    /// server has never answered, or the edge's key may not read them.
    pub at_ms: i64,
    /// Number of windows and results in this edge's store that the fleet has not acknowledged yet.
    pub outbox: u64,
    /// All windows in this edge's store by their progress; all 0 if the reporter is no edge.
    #[serde(default)]
    pub states: FleetStates,
    /// Alarms of this edge, as texts.
    #[serde(default)]
    pub alarms: Vec<String>,
    /// Answers that this edge has received since its daemon started.
    #[serde(default)]
    pub answers: FleetAnswers,
    /// Number of windows that the fleet has acknowledged since it was set up.
    pub windows: u64,
    /// Number of windows with a result in the fleet.
    pub results: u64,
    /// Number of windows in the fleet that no worker has identified yet.
    pub backlog: u64,
    /// Number of windows that were given up and neither replayed nor deleted since.
    pub dead: u64,
    /// Workers of the fleet.
    pub workers: Vec<FleetWorker>,
    /// Edges of the fleet: daemons with hobs.
    pub edges: Vec<FleetEdge>,
    /// Hobs of the fleet, sorted by name.
    pub devices: Vec<FleetDevice>,
}

/// Windows of an edge by their progress with the fleet; their sum is all windows in its store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct FleetStates {
    /// Not meant for the fleet: stored without samples or before there was a fleet, or not heating.
    pub not_for_fleet: u64,
    /// Due: the fleet has acknowledged neither them nor their results.
    pub due: u64,
    /// Sent: acknowledged by the fleet, results pending.
    pub sent: u64,
    /// Answered: the fleet's results are stored.
    pub answered: u64,
    /// Identified by this daemon; the fleet has acknowledged the results.
    pub learned_here: u64,
    /// Given up: their samples were deleted before they were sent.
    pub no_samples: u64,
    /// Given up: no worker could identify them.
    pub dead: u64,
    /// Time since which the first due window is due, in milliseconds since 1970, UTC; `None` if none is due.
    pub due_since_ms: Option<i64>,
    /// Time since which the first sent window waits for its result, in milliseconds since 1970, UTC; `None` if none waits.
    pub sent_since_ms: Option<i64>,
}

impl FleetStates {
    /// Returns the number of all windows.
    pub fn stored(&self) -> u64 {
        let windows = self.by_name().map(|(_, windows)| windows);
        windows.into_iter().fold(0, u64::saturating_add)
    }

    /// Adds the counts of other windows.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let first = |a: Option<i64>, b: Option<i64>| a.into_iter().chain(b).min();
        Self {
            not_for_fleet: self.not_for_fleet.saturating_add(other.not_for_fleet),
            due: self.due.saturating_add(other.due),
            sent: self.sent.saturating_add(other.sent),
            answered: self.answered.saturating_add(other.answered),
            learned_here: self.learned_here.saturating_add(other.learned_here),
            no_samples: self.no_samples.saturating_add(other.no_samples),
            dead: self.dead.saturating_add(other.dead),
            due_since_ms: first(self.due_since_ms, other.due_since_ms),
            sent_since_ms: first(self.sent_since_ms, other.sent_since_ms),
        }
    }

    /// Returns the number of windows in each state, with the state's name.
    pub fn by_name(&self) -> [(&'static str, u64); 7] {
        [
            ("not for fleet", self.not_for_fleet),
            ("due", self.due),
            ("sent", self.sent),
            ("answered", self.answered),
            ("learned here", self.learned_here),
            ("no samples", self.no_samples),
            ("dead", self.dead),
        ]
    }
}

/// Workers' answers to this edge's windows since the daemon started, by the verdict of the check against the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FleetAnswers {
    /// Answers confirmed by the window's samples; the lookup is updated with them.
    pub confirmed: u64,
    /// Answers refuted by the window's samples.
    pub refuted: u64,
    /// Answers computed with another sensor correction than the current one.
    pub outdated: u64,
    /// Answers without a result, or unreadable.
    pub unidentified: u64,
    /// Answers ignored because too many of their worker's answers were refuted.
    pub distrusted: u64,
}

impl FleetAnswers {
    /// Returns the number of answers of each verdict, with the verdict's name.
    pub fn by_name(&self) -> [(&'static str, u64); 5] {
        [
            ("confirmed", self.confirmed),
            ("refuted", self.refuted),
            ("outdated", self.outdated),
            ("unidentified", self.unidentified),
            ("distrusted", self.distrusted),
        ]
    }
}

/// Worker of a fleet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetWorker {
    /// Name of the worker.
    pub name: String,
    /// Version of its `ihd`.
    pub version: String,
    /// Number of threads that identify windows.
    pub threads: u32,
    /// Number of windows in progress.
    pub busy: u32,
    /// Number of windows that it has identified since its start.
    pub done: u64,
    /// Number of windows that it failed to identify.
    pub failed: u64,
    /// Time of its last message, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}

/// Edge of a fleet: a daemon with hobs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetEdge {
    /// Name of the edge.
    pub name: String,
    /// Version of its `ihd`.
    pub version: String,
    /// Number of windows and results in its store that the fleet has not acknowledged.
    pub outbox: u64,
    /// `true` while it leaves its windows to the fleet; otherwise it learns by itself.
    #[serde(rename = "trusts_fleet")]
    pub delegates: bool,
    /// All windows in its store by their progress.
    #[serde(default)]
    pub states: FleetStates,
    /// Its alarms, as texts.
    #[serde(default)]
    pub alarms: Vec<String>,
    /// Time of its last message, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}

/// Hob of a fleet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FleetDevice {
    /// Name of the hob, unique in the site.
    pub name: String,
    /// Name of its edge.
    pub edge: String,
    /// State, as serialised by [`super::DeviceState`].
    pub state: String,
    /// Pot on the coil; empty if unknown.
    pub pot: String,
    /// Build of its firmware; empty before the first handshake.
    pub build: String,
    /// Protocol version, major and minor.
    pub protocol: (u16, u16),
    /// Version of its active lookup.
    pub lookup_version: u32,
    /// `true` if its build differs from the most frequent one of its board or from the one set by `ihd-fleet init --build`.
    pub outdated: bool,
    /// Time of its last message, in milliseconds since 1970, UTC.
    pub last_seen_ms: i64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts come from other machines.
    #[test]
    fn counts_beyond_all_numbers_are_the_largest_one() {
        let forged = FleetStates {
            due: u64::MAX,
            sent: 1,
            ..FleetStates::default()
        };
        assert_eq!(forged.stored(), u64::MAX);
        let both = forged.and(forged);
        assert_eq!((both.due, both.sent), (u64::MAX, 2));
    }
}
