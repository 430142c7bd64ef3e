//! Retention: deletes days of windows that are too old, and the oldest rows of tables that only grow.

use std::path::{Path, PathBuf};

use rusqlite::Connection;
use serde::Serialize;

use super::folder::{self, DayFile};
use super::windows::SampleDropReason;
use super::{SamplePolicy, Store, StoreError, clock, database, lookups};

/// Most rows in each of the tables of results, events and commands: some 2 GB of results.
const MAX_ROWS: i64 = 10_000_000;

const DAY_MS: i64 = 24 * 3_600_000;

/// Result of a collection: deletions, and bytes that are left.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CollectionReport {
    /// Files deleted: days of windows, and damaged ones.
    pub deleted: Vec<PathBuf>,
    /// Bytes that they took.
    pub bytes: u64,
    /// Windows whose samples were deleted by [`SamplePolicy::Informative`].
    pub samples_dropped: u64,
    /// Rows of results, lookups, events and commands that were too many.
    pub rows: u64,
    /// Bytes that windows take now.
    pub bytes_left: u64,
    /// Windows whose samples were deleted to make room for newer ones.
    pub thinned: u64,
}

/// Files that were deleted.
#[derive(Debug, Default)]
pub(crate) struct DeletedFiles {
    paths: Vec<PathBuf>,
    bytes: u64,
}

impl DeletedFiles {
    fn add(&mut self, path: PathBuf, bytes: u64) {
        self.paths.push(path);
        self.bytes += bytes;
    }
}

impl Store {
    /// Deletes days of windows that are too old, today's never, also on a full disk; deletes samples without information if the policy is
    /// [`SamplePolicy::Informative`]; checkpoints the databases' logs, so that sizes are right; thins windows that take too much room
    /// (thinning.rs).
    ///
    /// # Errors
    /// Errors of the database or the operating system; deletions up to then are done.
    pub fn collect_garbage(&mut self) -> Result<CollectionReport, StoreError> {
        let mut collected = CollectionReport::default();
        let is_full = match self.grow_older() {
            Err(error) if error.is_full() => true,
            grown => grown.map(|()| false)?,
        };
        self.measure_other_days()?;
        let by_age = self.delete_by_age()?;
        if is_full {
            // Perhaps there is room now.
            self.grow_older()?;
        }
        self.end_sessions_that_were_cut_off()?;
        if self.options().keep == SamplePolicy::Informative {
            collected.samples_dropped = self.drop_uninformative_samples()?;
        }
        for table in ["results", "events", "audit"] {
            let sql = format!("DELETE FROM {table} WHERE id <= (SELECT max(id) FROM {table}) - ?1");
            collected.rows += self.drop_rows((&sql, MAX_ROWS))?;
        }
        collected.rows += self.drop_rows(lookups::DROP_PAST)?;
        checkpoint(self.records());
        for day in self.days.each() {
            checkpoint(&day.connection);
        }
        self.measure_other_days()?;
        let DeletedFiles {
            mut paths,
            mut bytes,
        } = by_age;
        let thinned = self.figures().thinned;
        self.make_room()?;
        // Room that thinning has freed is still in the logs.
        for day in self.days.each() {
            checkpoint(&day.connection);
        }
        self.measure_other_days()?;
        let DeletedFiles {
            paths: oldest,
            bytes: of_oldest,
        } = std::mem::take(&mut self.deleted);
        paths.extend(oldest);
        bytes += of_oldest;
        (collected.deleted, collected.bytes) = (paths, bytes);
        collected.thinned = self.figures().thinned - thinned;
        collected.bytes_left = self.other_days_bytes + folder::size(&self.path_of_today());
        self.report_thinned_lost_to_fleet();
        Ok(collected)
    }

    /// Deletes samples of accepted windows without effect on the lookup, in the open days; returns the number of windows.
    fn drop_uninformative_samples(&self) -> Result<u64, StoreError> {
        let mut dropped = 0;
        for day in self.days.each() {
            for (device, boot, seq) in day.keys()? {
                let sql = "SELECT EXISTS (SELECT 1 FROM results WHERE boot = ?2 AND seq = ?3
                    AND device = (SELECT id FROM devices WHERE name = ?1)
                    AND pass = 1 AND changed_lookup = 0)";
                let of = rusqlite::params![device, boot, seq];
                let is_uninformative = self.records().query_row(sql, of, |row| row.get(0));
                let is_uninformative: bool =
                    is_uninformative.map_err(self.failed("looking for a verdict"))?;
                if is_uninformative
                    && day.drop_samples(&device, boot, seq, SampleDropReason::Uninformative)?
                {
                    dropped += 1;
                }
            }
        }
        Ok(dropped)
    }

    fn drop_rows(&mut self, (sql, kept): (&str, i64)) -> Result<u64, StoreError> {
        let rows = self.change("deleting old rows", |change| change.execute(sql, [kept]))?;
        Ok(rows as u64)
    }

    pub(crate) fn measure_other_days(&mut self) -> Result<(), StoreError> {
        let today = self.path_of_today();
        let days = folder::days(self.folder())?.into_iter().map(|day| day.path);
        let damaged = folder::damaged_days(self.folder())?;
        let others = days.chain(damaged).filter(|path| *path != today);
        self.other_days_bytes = others.map(|path| folder::size(&path)).sum();
        Ok(())
    }

    /// Deletes days that are older than the setting, today's never. Age is time in use, so that no jump of the clock makes a day old.
    pub(crate) fn delete_by_age(&mut self) -> Result<DeletedFiles, StoreError> {
        let mut deleted = DeletedFiles::default();
        let today = clock::day(self.now());
        if let Some(days) = self.options().retention.max_age_days {
            // The day itself, and `days` more.
            let most_ms = i64::from(days).saturating_add(1).saturating_mul(DAY_MS);
            for (day, path) in self.by_age(&today)? {
                if self.age_of(&day)? >= most_ms {
                    deleted.add(path.clone(), self.delete_day(&day, &path)?);
                }
            }
        }
        // Last: a new day is written.
        self.age_of(&today)?;
        Ok(deleted)
    }

    /// Deletes the oldest file that is not today's and that `which` accepts; returns `false` if there is none.
    pub(crate) fn delete_oldest(
        &mut self,
        which: impl Fn(&Path) -> bool,
    ) -> Result<bool, StoreError> {
        let today = clock::day(self.now());
        let oldest = self
            .by_age(&today)?
            .into_iter()
            .find(|(_, path)| which(path));
        let Some((day, path)) = oldest else {
            return Ok(false);
        };
        let bytes = self.delete_day(&day, &path)?;
        self.deleted.add(path, bytes);
        Ok(true)
    }

    fn delete_day(&mut self, day: &str, path: &PathBuf) -> Result<u64, StoreError> {
        // A damaged day counts as 0.
        let lost = self.count_due_of(day).unwrap_or(0);
        self.days.close(path);
        self.tallies.remove(day);
        let freed = folder::delete(path)?;
        if lost > 0 {
            self.report_lost(day, lost);
        }
        self.other_days_bytes = self.other_days_bytes.saturating_sub(freed);
        if !folder::of_day(self.folder(), day).exists() {
            self.forget_age_of(day)?;
        }
        tracing::info!(file = %path.display(), bytes = freed, "deleted: retention");
        Ok(freed)
    }

    /// Reports, for each day, the windows whose samples were deleted before the fleet had answered.
    fn report_thinned_lost_to_fleet(&mut self) {
        for (day, lost) in std::mem::take(&mut self.lost_to_fleet) {
            self.report_lost(&day, lost);
        }
    }

    /// Reports windows of a day that were deleted before the fleet had all of them.
    fn report_lost(&mut self, day: &str, lost: u64) {
        let text = format!(
            "{lost} windows of {day} that the fleet had not answered are deleted: retention"
        );
        tracing::warn!("{text}");
        self.notice("store", &text);
    }

    /// Returns the files of all days but today's, and damaged ones, oldest first, each with its day.
    fn by_age(&self, today: &str) -> Result<Vec<(String, PathBuf)>, StoreError> {
        let of_name = |path: PathBuf| {
            let name = path.file_name()?.to_string_lossy().into_owned();
            let day = name.strip_prefix("windows-")?.get(..10)?.to_owned();
            Some((day, path))
        };
        let damaged = folder::damaged_days(self.folder())?;
        let days = folder::days(self.folder())?;
        let days = days.into_iter().filter(|file| file.day != today);
        let mut all: Vec<(String, PathBuf)> = days
            .map(|DayFile { day, path }| (day, path))
            .chain(damaged.into_iter().filter_map(of_name))
            .collect();
        all.sort();
        Ok(all)
    }

    fn path_of_today(&self) -> PathBuf {
        folder::of_day(self.folder(), &clock::day(self.now()))
    }

    pub(crate) fn today_bytes(&self) -> Result<u64, StoreError> {
        let path = self.path_of_today();
        let today = self.days.today.as_ref();
        match today.filter(|day| day.file.path == path) {
            Some(day) => day.used_bytes(),
            None => Ok(folder::size(&path)),
        }
    }
}

/// Writes a database's log back into it as far as readers of older states permit. It does not wait for them: the next checkpoint does the
/// rest.
pub(crate) fn checkpoint(connection: &Connection) {
    let sql = "PRAGMA wal_checkpoint(TRUNCATE)";
    let done = database::without_waiting(connection, || {
        connection.query_row(sql, [], |row| row.get::<_, bool>(0))
    });
    match done {
        Ok(false) => {}
        Ok(true) => tracing::debug!("checkpoint: a reader keeps the log"),
        Err(error) => tracing::debug!(%error, "checkpoint"),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;
    use crate::schema::RECORDS;

    /// Number of times that a statement has waited for another connection.
    static WAITS: AtomicU32 = AtomicU32::new(0);

    #[test]
    fn a_checkpoint_does_not_wait_for_a_reader() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(folder::RECORDS);
        let mut writer = database::open(&path, &RECORDS).unwrap();
        let reader = Connection::open(&path).unwrap();
        reader.execute_batch("BEGIN; SELECT * FROM events").unwrap();
        writer
            .execute_batch("INSERT INTO used (day, used_ms) VALUES ('', 0)")
            .unwrap();
        let counted = |_| {
            WAITS.fetch_add(1, Ordering::Relaxed);
            false
        };
        writer.busy_handler(Some(counted)).unwrap();
        checkpoint(&writer);
        assert_eq!(WAITS.load(Ordering::Relaxed), 0);
        // Other statements wait as before.
        let wait_ms = writer.pragma_query_value(None, "busy_timeout", |row| row.get::<_, u32>(0));
        assert_eq!(wait_ms.unwrap(), 5_000);
        // Without the reader all of the log is written back.
        drop(reader);
        checkpoint(&writer);
        assert_eq!(folder::size(&path), std::fs::metadata(&path).unwrap().len());
    }
}
