//! A trial of writing, for a store that failed.

use rusqlite::Connection;

use super::error::write_beside;
use super::{Store, StoreError, clock};

/// Room that a trial asks for: a window with what SQLite writes beside it, several times.
const ROOM: usize = 1 << 20;

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
