//! Trials of writing, for a store that failed and for one without a writer.

use std::iter::once;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::Connection;

use super::database::{self, IntegrityCheck};
use super::error::write_beside;
use super::folder::{self, Lock, RECORDS};
use super::{Store, StoreError, clock, schema};

/// Room that a trial requires: several windows with SQLite's log.
const ROOM_BYTES: usize = 1 << 20;

/// Time limit of the checks of all databases in a trial.
const CHECKS_TIMEOUT: Duration = Duration::from_secs(5);

/// Outcome of a trial of a store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrialReport {
    /// Databases that open and can be written.
    pub databases: usize,
    /// Databases among them whose every page was checked within the time limit.
    pub checked: usize,
}

/// Tries the store of a folder without a writer. Nothing is changed or set aside.
///
/// # Errors
/// [`StoreError::NoStore`]; [`StoreError::InUse`]; or the error that a daemon would get there.
pub fn try_folder(folder: &Path) -> Result<TrialReport, StoreError> {
    let records = folder.join(RECORDS);
    if !records.exists() {
        let folder = folder.to_owned();
        return Err(StoreError::NoStore { folder });
    }
    drop(Lock::take(folder)?);
    write_beside(&records, ROOM_BYTES).map_err(StoreError::files(&records, "looking for room"))?;
    let days = folder::days(folder)?.into_iter().rev();
    let days = days.map(|day| (day.path, &schema::WINDOWS));
    let began = Instant::now();
    let mut tried = TrialReport::default();
    for (path, schema) in once((records, &schema::RECORDS)).chain(days) {
        let left = CHECKS_TIMEOUT.saturating_sub(began.elapsed());
        let integrity = database::try_writing(&path, schema, left)?;
        tried.databases += 1;
        tried.checked += usize::from(integrity == IntegrityCheck::Ok);
    }
    Ok(tried)
}

impl Store {
    /// Commits to both databases without changing them, and finds room for a few windows beside each.
    ///
    /// # Errors
    /// Errors of the databases or the operating system, for which writing would fail too.
    pub fn try_writing(&mut self) -> Result<(), StoreError> {
        let path = self.path().to_owned();
        write_beside(&path, ROOM_BYTES).map_err(StoreError::files(&path, "looking for room"))?;
        commit(self.records()).map_err(self.failed("a trial of writing"))?;
        self.turn_to(&clock::day(self.now()))?;
        if let Some(day) = &self.days.today {
            let failed = StoreError::database(day.path(), "a trial of writing");
            commit(&day.connection).map_err(failed)?;
        }
        Ok(())
    }
}

/// Writes the page that holds the version, which stays.
fn commit(connection: &Connection) -> rusqlite::Result<()> {
    let version: i64 = connection.pragma_query_value(None, "user_version", |row| row.get(0))?;
    connection.pragma_update(None, "user_version", version)
}
