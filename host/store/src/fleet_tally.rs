//! Counts of windows by their state in a fleet.

use super::fleet_state::{FleetState, GiveUpReason};
use super::folder;
use super::windows::Day;
use super::{Store, StoreError};

/// Counts of windows by their state in a fleet; together all that are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FleetTally {
    /// Not for the fleet: stored without samples or before there was a fleet, or not heating.
    pub not_for_fleet: u64,
    /// To be sent ([`FleetState::Due`]).
    pub due: u64,
    /// Acknowledged by the fleet, without result.
    pub sent: u64,
    /// Answered by the fleet.
    pub answered: u64,
    /// Identified here.
    pub learned_here: u64,
    /// Given up: their samples were deleted before they were sent.
    pub no_samples: u64,
    /// Given up: no worker could identify them.
    pub dead: u64,
    /// Time since which the oldest due window is due, in milliseconds since 1970, UTC.
    pub due_since_ms: Option<i64>,
    /// Time since which the oldest sent window waits for its result, in milliseconds since 1970, UTC.
    pub sent_since_ms: Option<i64>,
}

impl FleetTally {
    /// Returns the number of all windows.
    pub fn stored(&self) -> u64 {
        self.not_for_fleet
            + self.due
            + self.sent
            + self.answered
            + self.learned_here
            + self.no_samples
            + self.dead
    }

    /// Adds the counts of another day.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let first = |a: Option<i64>, b: Option<i64>| a.into_iter().chain(b).min();
        Self {
            not_for_fleet: self.not_for_fleet + other.not_for_fleet,
            due: self.due + other.due,
            sent: self.sent + other.sent,
            answered: self.answered + other.answered,
            learned_here: self.learned_here + other.learned_here,
            no_samples: self.no_samples + other.no_samples,
            dead: self.dead + other.dead,
            due_since_ms: first(self.due_since_ms, other.due_since_ms),
            sent_since_ms: first(self.sent_since_ms, other.sent_since_ms),
        }
    }

    fn count(&mut self, state: FleetState, windows: u64, since_ms: i64) {
        let since = Some(since_ms);
        match state {
            FleetState::NotForFleet => self.not_for_fleet += windows,
            FleetState::Due => (self.due, self.due_since_ms) = (windows, since),
            FleetState::Sent => (self.sent, self.sent_since_ms) = (windows, since),
            FleetState::Answered => self.answered += windows,
            FleetState::LearnedHere => self.learned_here += windows,
            FleetState::GivenUp(GiveUpReason::NoSamples) => self.no_samples += windows,
            FleetState::GivenUp(GiveUpReason::Dead) => self.dead += windows,
        }
    }
}

impl Store {
    /// Returns the days with windows, oldest first, for [`Store::fleet_tally`].
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn days_of_windows(&self) -> Result<Vec<String>, StoreError> {
        let days = folder::days(self.folder())?;
        Ok(days.into_iter().map(|file| file.day).collect())
    }

    /// Counts the windows of a day by their state in the fleet; all zero if there is no such day.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn fleet_tally(&mut self, day: &str) -> Result<FleetTally, StoreError> {
        if let Some(tally) = self.tallies.get(day) {
            return Ok(*tally);
        }
        let file = self.file_of(day);
        if !file.path.exists() {
            return Ok(FleetTally::default());
        }
        let tally = self.on_day(file, Day::fleet_tally)?;
        self.tallies.insert(day.to_owned(), tally);
        Ok(tally)
    }
}

impl Day {
    /// Counts the windows of this day from an index alone, without reading past samples.
    fn fleet_tally(&self) -> Result<FleetTally, StoreError> {
        let read = || -> rusqlite::Result<FleetTally> {
            let mut statement = self.connection.prepare(
                "SELECT fleet, fleet_end, count(*), min(coalesce(fleet_ms, at_ms))
                 FROM windows INDEXED BY windows_at_fleet GROUP BY fleet, fleet_end",
            )?;
            let mut rows = statement.query([])?;
            let mut tally = FleetTally::default();
            while let Some(row) = rows.next()? {
                let end: Option<String> = row.get(1)?;
                let state = FleetState::of(row.get(0)?, end.as_deref());
                let windows = u64::try_from(row.get::<_, i64>(2)?).unwrap_or(0);
                tally.count(state, windows, row.get(3)?);
            }
            Ok(tally)
        };
        read().map_err(StoreError::database(self.path(), "counting windows"))
    }
}
