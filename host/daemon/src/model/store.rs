//! Condition of the store.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Kinds of records, told apart where they are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Record {
    /// Windows of devices.
    Windows,
    /// Results of identification.
    Results,
    /// Seconds of telemetry.
    Telemetry,
    /// Events: faults, notices.
    Events,
    /// Commands and their outcomes.
    Audits,
    /// Connections, lookups, progress with a fleet: written again until it is done.
    State,
}

/// Records that are in no store, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Dropped {
    /// Windows.
    pub windows: u64,
    /// Results of identification.
    pub results: u64,
    /// Seconds of telemetry of one device.
    pub telemetry_s: u64,
    /// Events.
    pub events: u64,
    /// Commands that the audit lacks.
    pub audits: u64,
}

impl Dropped {
    /// Counts `n` records; [`Record::State`] is never dropped.
    pub(crate) fn add(&mut self, record: Record, n: u64) {
        let count = match record {
            Record::Windows => &mut self.windows,
            Record::Results => &mut self.results,
            Record::Telemetry => &mut self.telemetry_s,
            Record::Events => &mut self.events,
            Record::Audits => &mut self.audits,
            Record::State => return,
        };
        *count = count.saturating_add(n);
    }

    /// Counts of all kinds, each with its name.
    pub fn by_kind(&self) -> [(&'static str, u64); 5] {
        [
            ("windows", self.windows),
            ("results", self.results),
            ("telemetry", self.telemetry_s),
            ("events", self.events),
            ("audits", self.audits),
        ]
    }

    /// Records dropped since an earlier count.
    pub(crate) fn since(&self, before: &Self) -> Self {
        Self {
            windows: self.windows - before.windows,
            results: self.results - before.results,
            telemetry_s: self.telemetry_s - before.telemetry_s,
            events: self.events - before.events,
            audits: self.audits - before.audits,
        }
    }

    /// Text such as `3 windows, 1 event`.
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

/// Why the store does not take records, the gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StoreCause {
    /// No room on the disk, in a quota, or below a limit of a file's size.
    DiskFull,
    /// Files that may not be written.
    NoPermission,
    /// A broken database.
    Damaged,
    /// A database that another program holds.
    Locked,
    /// No answer.
    Silent,
    /// Another error of the disk or the database.
    Failing,
    /// A fault of this program.
    Defect,
    /// More records than the disk takes.
    TooSlow,
}

impl StoreCause {
    /// The cause in plain words. No path is in it: `/healthz` needs no token.
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

    /// Advice to a person.
    pub fn advice(self) -> &'static str {
        match self {
            Self::DiskFull => {
                "Free space on that disk, or lower max_bytes under [keep] in ihd.toml. The daemon goes on by itself."
            }
            Self::NoPermission => {
                "Give the daemon's user the right to write to the store's folder and files, or mount the disk for writing. The daemon goes on by itself."
            }
            Self::Damaged => {
                "Start the daemon again: it sets the damaged file aside and goes on with a new one. docs/store.md says what can be rescued."
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

/// A store that does not take all records.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoreFailure {
    /// The gravest cause.
    pub cause: StoreCause,
    /// The cause in plain words.
    pub text: String,
    /// Advice to a person.
    pub advice: String,
    /// Since when, in milliseconds since 1970, UTC.
    pub since_ms: i64,
    /// Records dropped since then.
    pub dropped: Dropped,
}

impl StoreFailure {
    /// A store that does not answer at all.
    pub fn silent(now_ms: i64) -> Self {
        Self::new(StoreCause::Silent, now_ms, Dropped::default())
    }

    /// A failure of this cause.
    pub fn new(cause: StoreCause, since_ms: i64, dropped: Dropped) -> Self {
        Self {
            cause,
            text: cause.text().to_owned(),
            advice: cause.advice().to_owned(),
            since_ms,
            dropped,
        }
    }
}
