//! What a daemon that is an edge of a fleet knows of the whole (docs/fleet.md).

use ihd_store::FleetTally;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::learning::WorkerFigures;

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
    /// All windows in this edge's store by their progress; all 0 where this is none.
    #[serde(default)]
    pub states: FleetStates,
    /// Alarms of this edge, in words.
    #[serde(default)]
    pub alarms: Vec<String>,
    /// Answers that this edge has got since its daemon began.
    #[serde(default)]
    pub answers: FleetAnswers,
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

/// Windows of an edge by their progress with the fleet: together all in its store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct FleetStates {
    /// The fleet is not to have them: stored without samples or before there was a fleet, or not heating.
    pub not_for_fleet: u64,
    /// The fleet has acknowledged neither them nor their results.
    pub due: u64,
    /// The fleet has them, and owes results.
    pub sent: u64,
    /// The fleet's results are here.
    pub answered: u64,
    /// Their results were found here, and the fleet has those.
    pub learned_here: u64,
    /// Given up: their samples went before they were sent.
    pub no_samples: u64,
    /// Given up: no worker could identify them.
    pub dead: u64,
    /// Since when the first of those that are due is, in milliseconds since 1970, UTC; none without one.
    pub due_since_ms: Option<i64>,
    /// The same of those that are sent.
    pub sent_since_ms: Option<i64>,
}

impl FleetStates {
    /// All windows.
    pub fn stored(&self) -> u64 {
        self.by_name().iter().map(|(_, windows)| windows).sum()
    }

    /// States of windows, each with its name.
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

impl From<FleetTally> for FleetStates {
    fn from(tally: FleetTally) -> Self {
        Self {
            not_for_fleet: tally.not_for_fleet,
            due: tally.due,
            sent: tally.sent,
            answered: tally.answered,
            learned_here: tally.learned_here,
            no_samples: tally.no_samples,
            dead: tally.dead,
            due_since_ms: tally.due_since_ms,
            sent_since_ms: tally.sent_since_ms,
        }
    }
}

/// Workers' answers to this edge's windows since the daemon began, by what the windows made of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FleetAnswers {
    /// Confirmed by the window's samples: learned from.
    pub confirmed: u64,
    /// Refuted by them.
    pub refuted: u64,
    /// Found with other corrections of the sensors than are known now.
    pub outdated: u64,
    /// Empty or unreadable.
    pub unidentified: u64,
    /// Not looked at: their worker was caught too often.
    pub distrusted: u64,
}

impl FleetAnswers {
    /// Sums the records of workers.
    pub fn of<'a>(workers: impl Iterator<Item = &'a WorkerFigures>) -> Self {
        workers.fold(Self::default(), |sum, worker| Self {
            confirmed: sum.confirmed + worker.confirmed,
            refuted: sum.refuted + worker.refuted,
            outdated: sum.outdated + worker.outdated,
            unidentified: sum.unidentified + worker.unidentified,
            distrusted: sum.distrusted + worker.distrusted,
        })
    }

    /// Numbers of answers, each with its name.
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
    /// All windows in its store by their progress.
    #[serde(default)]
    pub states: FleetStates,
    /// Alarms there, in words.
    #[serde(default)]
    pub alarms: Vec<String>,
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
