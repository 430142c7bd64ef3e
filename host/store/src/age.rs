//! Age of days, counted in time that the store was in use, so that a jump of the clock deletes nothing.

use rusqlite::{OptionalExtension, params};

use super::{Store, StoreError};

/// Longest counted step between two collections, twice the daemon's period of collections. A longer pause or a jump of the clock counts
/// as this.
const MAX_STEP_MS: i64 = 20 * 60_000;

/// Key of the row with the total time in use.
const NOW: &str = "";

impl Store {
    /// Adds the time since this process's last collection to the time in use, up to [`MAX_STEP_MS`].
    pub(crate) fn grow_older(&mut self) -> Result<(), StoreError> {
        let now = self.now();
        let last = self.collected_ms.unwrap_or(now);
        let step = now.saturating_sub(last).clamp(0, MAX_STEP_MS);
        self.change("counting the time in use", |change| {
            change.execute(
                "INSERT INTO used (day, used_ms) VALUES (?1, ?2)
                 ON CONFLICT (day) DO UPDATE SET used_ms = used_ms + excluded.used_ms",
                params![NOW, step],
            )?;
            Ok(())
        })?;
        self.collected_ms = Some(now);
        Ok(())
    }

    /// Returns the time in use since a day's file was seen first, in milliseconds.
    pub(crate) fn age_of(&mut self, day: &str) -> Result<i64, StoreError> {
        self.change("telling the age of a day", |change| {
            let used = |day: &str| {
                let sql = "SELECT used_ms FROM used WHERE day = ?1";
                change.query_row(sql, [day], |row| row.get(0)).optional()
            };
            let now: i64 = used(NOW)?.unwrap_or(0);
            let Some(begun) = used(day)? else {
                let sql = "INSERT INTO used (day, used_ms) VALUES (?1, ?2)";
                change.execute(sql, params![day, now])?;
                return Ok(0);
            };
            Ok(now - begun)
        })
    }

    /// Deletes the age of a day that is deleted.
    pub(crate) fn forget_age_of(&mut self, day: &str) -> Result<(), StoreError> {
        self.change("forgetting a day", |change| {
            change
                .execute("DELETE FROM used WHERE day = ?1", [day])
                .map(drop)
        })
    }
}
