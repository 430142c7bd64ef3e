//! Progress of each window with a fleet: a few states, which add up to the windows stored (docs/fleet.md).
//!
//! ```text
//! due ──► sent ──► answered
//!  │       ├─────► given up: no worker could identify it; answered after all where it is replayed
//!  │       └─────► due again: the server has lost it
//!  ├─────────────► learned here: the fleet has its result
//!  └─────────────► given up: its samples went before it was sent
//! ```

use rusqlite::{OptionalExtension, Row, params};

use super::folder;
use super::outbox::DueWindow;
use super::windows::Day;
use super::{Store, StoreError};

/// `windows.fleet_end` of a window that was given up because it has no samples any more.
pub(crate) const NO_SAMPLES: &str = "no samples";

/// The same of one whose result was found here.
const LEARNED_HERE: &str = "learned here";

/// Begin of the same where the fleet has given it up; why follows.
const DEAD: &str = "dead: ";

/// Longest reason that is kept, in characters.
const LONGEST_WHY: usize = 200;

/// Progress of a window with a fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetState {
    /// The fleet is not to have it.
    NotForFleet,
    /// The fleet has acknowledged neither it nor its result.
    Due,
    /// The fleet has it, and owes a result.
    Sent,
    /// The fleet's result is here.
    Answered,
    /// Its result was found here, and the fleet has that.
    LearnedHere,
    /// Nobody will identify it.
    GivenUp(GivenUp),
}

/// Reason for which nobody will identify a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GivenUp {
    /// Its samples went before it was sent.
    NoSamples,
    /// No worker could.
    Dead,
}

/// Outcome of a window that was due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The fleet has the window, and owes a result.
    Window,
    /// The fleet has the result that was found here.
    Result,
    /// There was nothing to send any more.
    Nothing,
}

/// Marks of the fleet's server, by which one that lost its data is recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetMark {
    /// Time at which the consumer of this edge's results was made, in microseconds since 1970, UTC.
    ConsumerMade,
    /// The number that the last window has in the queue.
    LastWindow,
}

impl FleetState {
    /// Of the columns `fleet` and `fleet_end`.
    pub(crate) fn of(fleet: Option<i64>, end: Option<&str>) -> Self {
        match (fleet, end) {
            (None, _) => Self::NotForFleet,
            (Some(0), _) => Self::Due,
            (Some(1), _) => Self::Sent,
            (Some(_), None) => Self::Answered,
            (Some(_), Some(LEARNED_HERE)) => Self::LearnedHere,
            (Some(_), Some(NO_SAMPLES)) => Self::GivenUp(GivenUp::NoSamples),
            (Some(_), Some(_)) => Self::GivenUp(GivenUp::Dead),
        }
    }
}

impl Sent {
    /// The columns `fleet` and `fleet_end`.
    fn columns(self) -> (i64, Option<&'static str>) {
        match self {
            Self::Window => (1, None),
            Self::Result => (2, Some(LEARNED_HERE)),
            Self::Nothing => (2, Some(NO_SAMPLES)),
        }
    }
}

impl FleetMark {
    /// Its name in the table `fleet`.
    fn name(self) -> &'static str {
        match self {
            Self::ConsumerMade => "consumer made",
            Self::LastWindow => "last window",
        }
    }
}

impl Store {
    /// The fleet has a result of a window, of whatever day, and so has the store.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn answered(&mut self, device: &str, boot: u32, seq: u32) -> Result<(), StoreError> {
        self.end(device, boot, seq, None)
    }

    /// The fleet has given up a window, of whatever day, that it was sent.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn given_up(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
        why: &str,
    ) -> Result<(), StoreError> {
        let why: String = why.chars().take(LONGEST_WHY).collect();
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

    /// Windows that were sent before a time (milliseconds since 1970, UTC) and never answered are due again: the fleet has lost them, or
    /// their results. How many.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn due_again(&mut self, before_ms: i64) -> Result<u64, StoreError> {
        let (mut again, now_ms) = (0, self.now());
        for file in folder::days(self.folder())? {
            again += self.on_day(file, |day| day.due_again(before_ms, now_ms))?;
        }
        if again > 0 {
            self.none_due_to = None;
            self.tallies.clear();
        }
        Ok(again)
    }

    /// Windows that were sent before a time (milliseconds since 1970, UTC) and are not answered, the oldest days first: so many behind the
    /// first `skip`.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn unanswered(
        &mut self,
        before_ms: i64,
        mut skip: usize,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreError> {
        let mut found = Vec::new();
        for file in folder::days(self.folder())? {
            let left = limit - found.len();
            let of_day = self.on_day(file, |day| day.unanswered(before_ms, skip + left))?;
            let skipped = skip.min(of_day.len());
            skip -= skipped;
            found.extend(of_day.into_iter().skip(skipped));
            if found.len() >= limit {
                break;
            }
        }
        Ok(found)
    }

    /// Progress of a window of whatever day with a fleet; `None` if the store does not hold it.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn fleet_state(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<FleetState>, StoreError> {
        let mut days = folder::days(self.folder())?;
        days.reverse();
        for file in days {
            let state = self.on_day(file, |day| day.fleet_state(device, boot, seq))?;
            if state.is_some() {
                return Ok(state);
            }
        }
        Ok(None)
    }

    /// Marks of the fleet's server.
    ///
    /// # Errors
    /// What the database reports.
    pub fn fleet_mark(&self, mark: FleetMark) -> Result<Option<i64>, StoreError> {
        let sql = "SELECT value FROM fleet WHERE what = ?1";
        let found = self
            .records()
            .query_row(sql, [mark.name()], |row| row.get(0));
        found
            .optional()
            .map_err(self.failed("looking for what a fleet was"))
    }

    /// Remembers something of the fleet's server.
    ///
    /// # Errors
    /// What the database reports.
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
    pub(crate) fn note(&self, sent: &[(DueWindow, Sent)], now_ms: i64) -> Result<(), StoreError> {
        // Never back: an answer may have been faster than the acknowledgement.
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

    /// False where the window is none of this day. What was given up may be answered after all. An answer to what is due is the edge's own
    /// result, which comes back to it as any other.
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
                Ok(FleetState::of(row.get(0)?, end.as_deref()))
            });
        state
            .optional()
            .map_err(StoreError::database(self.path(), "looking for a window"))
    }

    fn due_again(&self, before_ms: i64, now_ms: i64) -> Result<u64, StoreError> {
        let sql = "UPDATE windows SET fleet = 0, fleet_ms = ?2
            WHERE fleet = 1 AND coalesce(fleet_ms, at_ms) < ?1";
        let rows = self.connection.execute(sql, [before_ms, now_ms]);
        let rows = rows.map_err(StoreError::database(self.path(), "looking for answers"))?;
        Ok(rows as u64)
    }

    fn unanswered(&self, before_ms: i64, limit: usize) -> Result<Vec<DueWindow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<DueWindow>> {
            let mut statement = self.connection.prepare(
                "SELECT device, boot, seq, at_ms FROM windows
                 WHERE fleet = 1 AND fleet_end IS NULL AND coalesce(fleet_ms, at_ms) < ?1
                 ORDER BY fleet_ms, at_ms, id LIMIT ?2",
            )?;
            let row = |row: &Row<'_>| self.due_window(row);
            statement
                .query_map(params![before_ms, limit as i64], row)?
                .collect()
        };
        read().map_err(StoreError::database(self.path(), "looking for answers"))
    }
}
