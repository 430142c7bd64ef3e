//! State of the store: failures and dropped records.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Kind of a record, by which losses are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordKind {
    /// Windows of devices.
    Windows,
    /// Results of identification.
    Results,
    /// Seconds of telemetry.
    Telemetry,
    /// Events: faults, changes of state.
    Events,
    /// Commands and their outcomes.
    Audits,
    /// Connections, lookups, progress with a fleet: retried until written.
    State,
}

/// Numbers of records that were dropped unstored, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = Dropped)]
pub struct DroppedRecords {
    /// Windows.
    pub windows: u64,
    /// Results of identification.
    pub results: u64,
    /// Seconds of telemetry of one device.
    pub telemetry_s: u64,
    /// Events.
    pub events: u64,
    /// Commands missing in the audit.
    pub audits: u64,
}

impl DroppedRecords {
    /// Counts `n` records; [`RecordKind::State`] is never dropped.
    pub fn add(&mut self, record: RecordKind, n: u64) {
        let count = match record {
            RecordKind::Windows => &mut self.windows,
            RecordKind::Results => &mut self.results,
            RecordKind::Telemetry => &mut self.telemetry_s,
            RecordKind::Events => &mut self.events,
            RecordKind::Audits => &mut self.audits,
            RecordKind::State => return,
        };
        *count = count.saturating_add(n);
    }

    /// Returns the number of each kind, with the kind's name.
    pub fn by_kind(&self) -> [(&'static str, u64); 5] {
        [
            ("windows", self.windows),
            ("results", self.results),
            ("telemetry", self.telemetry_s),
            ("events", self.events),
            ("audits", self.audits),
        ]
    }

    /// Returns the numbers dropped since an earlier count.
    pub fn since(&self, before: &Self) -> Self {
        Self {
            windows: self.windows - before.windows,
            results: self.results - before.results,
            telemetry_s: self.telemetry_s - before.telemetry_s,
            events: self.events - before.events,
            audits: self.audits - before.audits,
        }
    }

    /// Formats the numbers, such as `3 windows, 1 event`.
    pub fn text(&self) -> String {
        let counts = [
            (self.windows, "window", "windows"),
            (self.results, "result", "results"),
            (
                self.telemetry_s,
                "second of telemetry",
                "seconds of telemetry",
            ),
            (self.events, "event", "events"),
            (self.audits, "command of the audit", "commands of the audit"),
        ];
        let counted = counts.iter().filter(|(n, ..)| *n > 0);
        let counted: Vec<_> = counted
            .map(|(n, one, many)| format!("{n} {}", if *n == 1 { one } else { many }))
            .collect();
        match counted.is_empty() {
            true => "nothing".to_owned(),
            false => counted.join(", "),
        }
    }
}

/// Cause of a store failure, the gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StoreCause {
    /// No room on the disk, in a quota, or within the limit of a file's size.
    DiskFull,
    /// No permission to write the files.
    NoPermission,
    /// Damaged database.
    Damaged,
    /// Database locked by another program.
    Locked,
    /// No answer of the store.
    Silent,
    /// Another error of the disk or the database.
    Failing,
    /// Defect of this program.
    Defect,
    /// More records than the disk can take.
    TooSlow,
}

impl StoreCause {
    /// Describes the cause, without any path: `/healthz` needs no token.
    pub fn text(self) -> &'static str {
        match self {
            Self::DiskFull => "the store's disk is full",
            Self::NoPermission => "the store's files may not be written",
            Self::Damaged => "a database of the store is damaged",
            Self::Locked => "another program keeps a database of the store locked",
            Self::Silent => "the store has not answered for ten seconds",
            Self::Failing => "the store's disk reports an error",
            Self::Defect => "writing failed for a fault of this program",
            Self::TooSlow => "the store is slower than what comes in",
        }
    }

    /// Returns advice for the operator.
    pub fn advice(self) -> &'static str {
        match self {
            Self::DiskFull => {
                "Free space on that disk, or lower max_bytes under [keep] in ihd.toml. The daemon goes on by itself."
            }
            Self::NoPermission => {
                "Give the daemon's user the right to write to the store's folder and files, or mount the disk for writing. The daemon goes on by itself."
            }
            Self::Damaged => {
                "Start the daemon again: it sets the damaged file aside and goes on with a new one. docs/daemon.md says what can be rescued."
            }
            Self::Locked => {
                "End the program that has opened a database of the store for writing. The daemon goes on by itself."
            }
            Self::Silent => {
                "Look at the disk: it may be failing, or be a network drive that is gone. The system's log has more."
            }
            Self::Failing => {
                "Look at the disk and at the system's log; the daemon's log has the error."
            }
            Self::Defect => "Report it, with the daemon's log.",
            Self::TooSlow => {
                "Look for what else uses the disk, or keep fewer windows: windows = \"telling\" or \"one-in-10\" under [keep] in ihd.toml."
            }
        }
    }
}

/// Failure of the store to take all records.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoreFailure {
    /// Gravest cause.
    pub cause: StoreCause,
    /// Description of the cause.
    pub text: String,
    /// Advice for the operator.
    pub advice: String,
    /// Start of the failure, in milliseconds since 1970, UTC.
    pub since_ms: i64,
    /// Records dropped since then.
    pub dropped: DroppedRecords,
}

impl StoreFailure {
    /// Creates the failure of a store that does not answer.
    pub fn silent(now_ms: i64) -> Self {
        Self::new(StoreCause::Silent, now_ms, DroppedRecords::default())
    }

    /// Creates a failure of this cause.
    pub fn new(cause: StoreCause, since_ms: i64, dropped: DroppedRecords) -> Self {
        Self {
            cause,
            text: cause.text().to_owned(),
            advice: cause.advice().to_owned(),
            since_ms,
            dropped,
        }
    }
}
