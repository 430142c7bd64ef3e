//! Age of days by the time that the store was in use: a clock that jumps deletes nothing.

use rusqlite::{OptionalExtension, params};

use super::{Store, StoreError};

/// Longest step between two collections that counts, twice what a daemon leaves between them: time off, or a jump of the clock, counts
/// as this.
const LONGEST_STEP_MS: i64 = 20 * 60_000;

/// The row that holds the time in use so far.
const NOW: &str = "";

impl Store {
    /// Counts the time since the last collection of this process, as far as it counts.
    pub(crate) fn grow_older(&mut self) -> Result<(), StoreError> {
        let now = self.now();
        let last = self.collected_ms.replace(now).unwrap_or(now);
        let step = now.saturating_sub(last).clamp(0, LONGEST_STEP_MS);
        self.change("counting the time in use", |change| {
            change.execute(
                "INSERT INTO used (day, used_ms) VALUES (?1, ?2)
                 ON CONFLICT (day) DO UPDATE SET used_ms = used_ms + excluded.used_ms",
                params![NOW, step],
            )?;
            Ok(())
        })
    }

    /// Time in use since a day's file was seen first, in milliseconds.
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

    /// Forgets the age of a day that is deleted.
    pub(crate) fn forget_age_of(&mut self, day: &str) -> Result<(), StoreError> {
        self.change("forgetting a day", |change| {
            change
                .execute("DELETE FROM used WHERE day = ?1", [day])
                .map(drop)
        })
    }
}
