//! State of each window in a fleet; the counts of all states add up to the windows stored (docs/fleet.md).
//!
//! ```text
//! due ──► sent ──► answered
//!  │       ├─────► given up: no worker could identify it; answered after all if it is replayed
//!  │       └─────► due again: the server has lost it
//!  ├─────────────► learned here: the fleet has its result
//!  └─────────────► given up: its samples were deleted or damaged before it was sent
//! ```

use rusqlite::{OptionalExtension, Row, params};

use super::due_window::DueWindow;
use super::folder;
use super::windows::{Day, NO_SAMPLES};
use super::{Store, StoreError};

/// `windows.fleet_end` of a window whose result was computed here.
const LEARNED_HERE: &str = "learned here";

/// Beginning of `windows.fleet_end` of a window that the fleet has given up; the reason follows.
const DEAD: &str = "dead: ";

/// `windows.fleet_end` of a window that cannot be read any more.
const DAMAGED: &str = "dead: damaged in the store";

/// Longest stored reason, in characters.
const MAX_REASON_CHARS: usize = 200;

/// State of a window in a fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetState {
    /// Not for the fleet.
    NotForFleet,
    /// To be sent: the fleet has acknowledged neither the window nor its result.
    Due,
    /// Acknowledged by the fleet; no result yet.
    Sent,
    /// Answered: the fleet's result is stored.
    Answered,
    /// Identified here; the fleet has acknowledged the result.
    LearnedHere,
    /// Given up: it will not be identified.
    GivenUp(GiveUpReason),
}

/// Reason for which a window was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GiveUpReason {
    /// Its samples were deleted before it was sent, or answered.
    NoSamples,
    /// No worker could identify it, or it cannot be read.
    Dead,
}

/// Outcome of the delivery of a due window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeliveryState {
    /// The fleet has acknowledged the window; its result is to come.
    Window,
    /// The fleet has acknowledged the result that was computed here.
    Result,
    /// Neither samples nor a result are left to send.
    Nothing,
    /// Its samples cannot be read.
    Damaged,
}

/// Stored marks of the fleet's server, which show if it has lost its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetMark {
    /// Creation time of the consumer of this edge's results, in microseconds since 1970, UTC.
    ConsumerMade,
    /// Sequence number of the last window in the queue.
    LastWindow,
}

impl FleetState {
    /// Reads the state from the columns `fleet` and `fleet_end`.
    pub(crate) fn from_columns(fleet: Option<i64>, end: Option<&str>) -> Self {
        match (fleet, end) {
            (None, _) => Self::NotForFleet,
            (Some(0), _) => Self::Due,
            (Some(1), _) => Self::Sent,
            (Some(_), None) => Self::Answered,
            (Some(_), Some(LEARNED_HERE)) => Self::LearnedHere,
            (Some(_), Some(NO_SAMPLES)) => Self::GivenUp(GiveUpReason::NoSamples),
            (Some(_), Some(_)) => Self::GivenUp(GiveUpReason::Dead),
        }
    }
}

impl DeliveryState {
    /// Returns the columns `fleet` and `fleet_end`.
    fn columns(self) -> (i64, Option<&'static str>) {
        match self {
            Self::Window => (1, None),
            Self::Result => (2, Some(LEARNED_HERE)),
            Self::Nothing => (2, Some(NO_SAMPLES)),
            Self::Damaged => (2, Some(DAMAGED)),
        }
    }
}

impl FleetMark {
    /// Returns its name in the table `fleet`.
    fn name(self) -> &'static str {
        match self {
            Self::ConsumerMade => "consumer made",
            Self::LastWindow => "last window",
        }
    }
}

impl Store {
    /// Marks a window of any day as answered by the fleet; its result is stored.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn mark_answered(&mut self, device: &str, boot: u32, seq: u32) -> Result<(), StoreError> {
        self.end(device, boot, seq, None)
    }

    /// Marks a sent window of any day as given up by the fleet.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn mark_given_up(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
        why: &str,
    ) -> Result<(), StoreError> {
        let why: String = why.chars().take(MAX_REASON_CHARS).collect();
        self.end(device, boot, seq, Some(&format!("{DEAD}{why}")))
    }

    fn end(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
        end: Option<&str>,
    ) -> Result<(), StoreError> {
        let now_ms = self.now();
        let mut days = folder::days(self.folder())?;
        days.reverse();
        for file in days {
            let name = file.day.clone();
            if self.on_day(file, |day| day.end(device, boot, seq, end, now_ms))? {
                self.tallies.remove(&name);
                return Ok(());
            }
        }
        Ok(())
    }

    /// Makes windows due again that were sent before a time (milliseconds since 1970, UTC) and never answered: the fleet has lost them or
    /// their results. The same for those that seem to be sent after now: the clock was put back since. Returns their number.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn requeue_unanswered(&mut self, before_ms: i64) -> Result<u64, StoreError> {
        let (mut again, now_ms) = (0, self.now());
        for file in folder::days(self.folder())? {
            again += self.on_day(file, |day| day.requeue_unanswered(before_ms, now_ms))?;
        }
        if again > 0 {
            self.none_due_to = None;
            self.tallies.clear();
        }
        Ok(again)
    }

    /// Returns windows that were sent before a time (milliseconds since 1970, UTC) and are not answered, the oldest days first: at most
    /// `limit` after the first `skip`. Those that seem to be sent after now are among them: the clock was put back since.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn unanswered(
        &mut self,
        before_ms: i64,
        mut skip: usize,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreError> {
        let (mut due, now_ms) = (Vec::new(), self.now());
        for file in folder::days(self.folder())? {
            let left = limit - due.len();
            let of_day =
                self.on_day(file, |day| day.unanswered((before_ms, now_ms), skip + left))?;
            let skipped = skip.min(of_day.len());
            skip -= skipped;
            due.extend(of_day.into_iter().skip(skipped));
            if due.len() >= limit {
                break;
            }
        }
        Ok(due)
    }

    /// Returns the state of a window of any day in the fleet; `None` if the store does not hold the window.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn fleet_state(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<FleetState>, StoreError> {
        self.on_newest_day(|day| day.fleet_state(device, boot, seq))
    }

    /// Returns a mark of the fleet's server; `None` if it was never stored.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn fleet_mark(&self, mark: FleetMark) -> Result<Option<i64>, StoreError> {
        let sql = "SELECT value FROM fleet WHERE what = ?1";
        let value = self
            .records()
            .query_row(sql, [mark.name()], |row| row.get(0));
        value
            .optional()
            .map_err(self.failed("looking for what a fleet was"))
    }

    /// Stores a mark of the fleet's server.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn mark_fleet(&mut self, mark: FleetMark, value: i64) -> Result<(), StoreError> {
        self.change("noting what a fleet is", |change| {
            change.execute(
                "INSERT INTO fleet (what, value) VALUES (?1, ?2)
                 ON CONFLICT (what) DO UPDATE SET value = ?2",
                params![mark.name(), value],
            )?;
            Ok(())
        })
    }
}

impl Day {
    pub(crate) fn note(
        &self,
        sent: &[(DueWindow, DeliveryState)],
        now_ms: i64,
    ) -> Result<(), StoreError> {
        // Never to a lower state: an answer may come before the acknowledgement.
        let sql = "UPDATE windows SET fleet = ?4, fleet_end = ?5, fleet_ms = ?6
            WHERE device = ?1 AND boot = ?2 AND seq = ?3 AND fleet < ?4";
        let note = || {
            let change = self.connection.unchecked_transaction()?;
            for (due, sent) in sent {
                let (fleet, end) = sent.columns();
                let of = params![due.device, due.boot, due.seq, fleet, end, now_ms];
                change.execute(sql, of)?;
            }
            change.commit()
        };
        note().map_err(StoreError::database(self.path(), "noting what was sent"))
    }

    /// Ends a window's delivery; returns `false` if the window is not of this day. A window that was given up can still be answered. An
    /// answer to a due one is the edge's own result, which comes back to it as any other.
    fn end(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
        end: Option<&str>,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let sql = "UPDATE windows SET fleet = 2, fleet_ms = ?5,
            fleet_end = iif(?4 IS NULL AND fleet = 0, 'learned here', ?4)
            WHERE device = ?1 AND boot = ?2 AND seq = ?3
            AND (fleet < 2 OR ?4 IS NULL AND fleet_end GLOB 'dead: *')";
        let of = params![device, boot, seq, end, now_ms];
        let rows = self.connection.execute(sql, of);
        match rows.map_err(StoreError::database(self.path(), "noting an answer"))? {
            0 => self.holds(device, boot, seq),
            _ => Ok(true),
        }
    }

    fn fleet_state(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<FleetState>, StoreError> {
        let sql = "SELECT fleet, fleet_end FROM windows
            WHERE device = ?1 AND boot = ?2 AND seq = ?3";
        let state = self
            .connection
            .query_row(sql, params![device, boot, seq], |row| {
                let end: Option<String> = row.get(1)?;
                Ok(FleetState::from_columns(row.get(0)?, end.as_deref()))
            });
        state
            .optional()
            .map_err(StoreError::database(self.path(), "looking for a window"))
    }

    fn requeue_unanswered(&self, before_ms: i64, now_ms: i64) -> Result<u64, StoreError> {
        let sql = "UPDATE windows SET fleet = 0, fleet_ms = ?2
            WHERE fleet = 1 AND (coalesce(fleet_ms, at_ms) < ?1 OR coalesce(fleet_ms, at_ms) > ?2)";
        let rows = self.connection.execute(sql, [before_ms, now_ms]);
        let rows = rows.map_err(StoreError::database(self.path(), "looking for answers"))?;
        Ok(rows as u64)
    }

    fn unanswered(
        &self,
        (before_ms, now_ms): (i64, i64),
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<DueWindow>> {
            let mut statement = self.connection.prepare(
                "SELECT device, boot, seq, at_ms FROM windows
                 WHERE fleet = 1 AND fleet_end IS NULL
                     AND (coalesce(fleet_ms, at_ms) < ?1 OR coalesce(fleet_ms, at_ms) > ?2)
                 ORDER BY fleet_ms, at_ms, id LIMIT ?3",
            )?;
            let row = |row: &Row<'_>| self.due_window(row);
            statement
                .query_map(params![before_ms, now_ms, limit as i64], row)?
                .collect()
        };
        read().map_err(StoreError::database(self.path(), "looking for answers"))
    }
}
