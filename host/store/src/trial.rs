//! Trials of writing, for a store that failed and for one that nobody writes to.

use std::iter::once;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::Connection;

use super::database::{self, Found};
use super::error::write_beside;
use super::folder::{self, Lock, RECORDS};
use super::{Store, StoreError, clock, schema};

/// Room that a trial asks for: a window with what SQLite writes beside it, several times.
const ROOM: usize = 1 << 20;

/// Time that the checks of all databases of a store may take in a trial.
const CHECKS: Duration = Duration::from_secs(5);

/// Outcome of a trial of a store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tried {
    /// Databases that open and take a write.
    pub databases: usize,
    /// Of these, databases of which every page was looked at within the time for it.
    pub checked: usize,
}

/// Tries the store of a folder that no process writes to. It changes nothing, and sets nothing aside.
///
/// # Errors
/// [`StoreError::NoStore`]; [`StoreError::InUse`]; else what a daemon that begins there would meet.
pub fn try_folder(folder: &Path) -> Result<Tried, StoreError> {
    let records = folder.join(RECORDS);
    if !records.exists() {
        let folder = folder.to_owned();
        return Err(StoreError::NoStore { folder });
    }
    drop(Lock::take(folder)?);
    write_beside(&records, ROOM).map_err(StoreError::files(&records, "looking for room"))?;
    let days = folder::days(folder)?.into_iter().rev();
    let days = days.map(|day| (day.path, &schema::WINDOWS));
    let began = Instant::now();
    let mut tried = Tried::default();
    for (path, schema) in once((records, &schema::RECORDS)).chain(days) {
        let left = CHECKS.saturating_sub(began.elapsed());
        let found = database::try_writing(&path, schema, left)?;
        tried.databases += 1;
        tried.checked += usize::from(found == Found::Whole);
    }
    Ok(tried)
}

impl Store {
    /// Commits to both databases without changing them, and finds room for a few windows beside each.
    ///
    /// # Errors
    /// What the databases or the operating system report: a record would fail for the same.
    pub fn try_writing(&mut self) -> Result<(), StoreError> {
        let path = self.path().to_owned();
        write_beside(&path, ROOM).map_err(StoreError::files(&path, "looking for room"))?;
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
