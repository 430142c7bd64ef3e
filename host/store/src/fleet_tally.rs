//! Counts of windows by their state in a fleet.

use ihd_model::FleetStates;

use super::fleet_state::{FleetState, GiveUpReason};
use super::folder;
use super::windows::Day;
use super::{Store, StoreError};

fn count(states: &mut FleetStates, state: FleetState, windows: u64, since_ms: i64) {
    let since = Some(since_ms);
    match state {
        FleetState::NotForFleet => states.not_for_fleet += windows,
        FleetState::Due => (states.due, states.due_since_ms) = (windows, since),
        FleetState::Sent => (states.sent, states.sent_since_ms) = (windows, since),
        FleetState::Answered => states.answered += windows,
        FleetState::LearnedHere => states.learned_here += windows,
        FleetState::GivenUp(GiveUpReason::NoSamples) => states.no_samples += windows,
        FleetState::GivenUp(GiveUpReason::Dead) => states.dead += windows,
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
    pub fn fleet_tally(&mut self, day: &str) -> Result<FleetStates, StoreError> {
        if let Some(tally) = self.tallies.get(day) {
            return Ok(*tally);
        }
        let file = self.file_of(day);
        if !file.path.exists() {
            return Ok(FleetStates::default());
        }
        let tally = self.on_day(file, Day::fleet_tally)?;
        self.tallies.insert(day.to_owned(), tally);
        Ok(tally)
    }
}

impl Day {
    /// Counts the windows of this day from an index alone, without reading past samples.
    fn fleet_tally(&self) -> Result<FleetStates, StoreError> {
        let read = || -> rusqlite::Result<FleetStates> {
            let mut statement = self.connection.prepare(
                "SELECT fleet, fleet_end, count(*), min(coalesce(fleet_ms, at_ms))
                 FROM windows INDEXED BY windows_at_fleet GROUP BY fleet, fleet_end",
            )?;
            let mut rows = statement.query([])?;
            let mut tally = FleetStates::default();
            while let Some(row) = rows.next()? {
                let end: Option<String> = row.get(1)?;
                let state = FleetState::from_columns(row.get(0)?, end.as_deref());
                let windows = u64::try_from(row.get::<_, i64>(2)?).unwrap_or(0);
                count(&mut tally, state, windows, row.get(3)?);
            }
            Ok(tally)
        };
        read().map_err(StoreError::database(self.path(), "counting windows"))
    }
}
