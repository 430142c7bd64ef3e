//! What is deleted: whole days of windows, and the oldest rows of tables that only grow.

use std::path::PathBuf;

use rusqlite::Connection;
use serde::Serialize;

use super::folder::{self, DayFile};
use super::windows::NotKept;
use super::{Keep, Store, StoreError, clock};

/// Rows that the tables of results, events and commands may each have: some 2 GB of results.
const MAX_ROWS: i64 = 10_000_000;

const DAY_MS: i64 = 24 * 3_600_000;

/// What a collection deleted, and what is left.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Collected {
    /// Files deleted: days of windows, and damaged ones.
    pub deleted: Vec<PathBuf>,
    /// Bytes that they took.
    pub bytes: u64,
    /// Windows whose samples were dropped because they tell nothing.
    pub samples_dropped: u64,
    /// Rows of results, events and commands that were too many.
    pub rows: u64,
    /// Bytes that windows take now.
    pub bytes_left: u64,
    /// Whether today's windows alone take more than windows may: their samples are then not kept.
    pub today_is_too_large: bool,
}

impl Store {
    /// Deletes days of windows that are too old or too many, today's never; drops samples that tell
    /// nothing, where the settings say so; brings the databases' logs into them, so that sizes are honest.
    ///
    /// # Errors
    /// What the database or the operating system reports; what was deleted until then is deleted.
    pub fn collect_garbage(&mut self) -> Result<Collected, StoreError> {
        let mut collected = Collected::default();
        if self.settings().keep == Keep::Telling {
            collected.samples_dropped = self.drop_what_tells_nothing()?;
        }
        for table in ["results", "events", "audit"] {
            collected.rows += self.drop_rows(table)?;
        }
        checkpoint(self.records());
        for day in self.days.each() {
            checkpoint(&day.connection);
        }
        self.measure_other_days()?;
        let (deleted, bytes) = self.delete_old_days()?;
        (collected.deleted, collected.bytes) = (deleted, bytes);
        collected.bytes_left = self.other_days_bytes + folder::size(&self.path_of_today());
        collected.today_is_too_large = !self.has_room_today()?;
        Ok(collected)
    }

    /// Windows of the days at hand whose verdict came, and whose samples are still there.
    fn drop_what_tells_nothing(&self) -> Result<u64, StoreError> {
        let mut dropped = 0;
        for day in self.days.each() {
            for (device, boot, seq) in day.keys()? {
                let sql = "SELECT EXISTS (SELECT 1 FROM results WHERE boot = ?2 AND seq = ?3
                    AND device = (SELECT id FROM devices WHERE name = ?1)
                    AND pass = 1 AND changed_lookup = 0)";
                let of = rusqlite::params![device, boot, seq];
                let tells_nothing = self.records().query_row(sql, of, |row| row.get(0));
                let tells_nothing: bool =
                    tells_nothing.map_err(self.failed("looking for a verdict"))?;
                if tells_nothing && day.drop_samples(&device, boot, seq, NotKept::TellsNothing)? {
                    dropped += 1;
                }
            }
        }
        Ok(dropped)
    }

    fn drop_rows(&mut self, table: &str) -> Result<u64, StoreError> {
        let sql = format!("DELETE FROM {table} WHERE id <= (SELECT max(id) FROM {table}) - ?1");
        let rows = self.change("deleting old rows", |change| {
            change.execute(&sql, [MAX_ROWS])
        })?;
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

    /// Deletes what is too old, and then the oldest until the rest fits, today's never.
    pub(crate) fn delete_old_days(&mut self) -> Result<(Vec<PathBuf>, u64), StoreError> {
        let retention = self.settings().retention;
        let now = self.now();
        let today = clock::day(now);
        let first_kept = retention.max_age_days.map(|days| {
            let age_ms = i64::from(days).saturating_mul(DAY_MS);
            clock::day(now.saturating_sub(age_ms).max(0))
        });
        let today_bytes = self.today_bytes()?;
        let (mut deleted, mut bytes) = (Vec::new(), 0);
        for (day, path) in self.by_age(&today)? {
            let too_old = first_kept.as_ref().is_some_and(|first| day < *first);
            let too_many = self.other_days_bytes + today_bytes > retention.max_bytes;
            if !(too_old || too_many) {
                continue;
            }
            self.tell_lost_to_fleet(&day)?;
            self.days.close(&path);
            let freed = folder::delete(&path)?;
            self.other_days_bytes = self.other_days_bytes.saturating_sub(freed);
            tracing::info!(file = %path.display(), bytes = freed, "deleted: retention");
            bytes += freed;
            deleted.push(path);
        }
        Ok((deleted, bytes))
    }

    /// A day that goes before a fleet has got all of it is told.
    fn tell_lost_to_fleet(&mut self, day: &str) -> Result<(), StoreError> {
        // A damaged one tells nothing.
        let lost = self.count_due_of(day).unwrap_or(0);
        if lost == 0 {
            return Ok(());
        }
        let text =
            format!("{lost} windows of {day} that the fleet had not got are deleted: retention");
        tracing::warn!("{text}");
        self.event(None, "store", &text)
    }

    /// Days but today's, and damaged ones, oldest first, each with its day.
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

    fn today_bytes(&self) -> Result<u64, StoreError> {
        let path = self.path_of_today();
        let today = self.days.today.as_ref();
        match today.filter(|day| day.file.path == path) {
            Some(day) => day.used_bytes(),
            None => Ok(folder::size(&path)),
        }
    }

    /// Whether samples may be kept now, after the oldest days have made room.
    pub(crate) fn has_room_today(&mut self) -> Result<bool, StoreError> {
        let max = self.settings().retention.max_bytes;
        let today = self.today_bytes()?;
        if self.other_days_bytes.saturating_add(today) <= max {
            return Ok(true);
        }
        if today <= max {
            self.delete_old_days()?;
        }
        Ok(self.other_days_bytes.saturating_add(today) <= max)
    }
}

/// Brings a database's log into it. A reader may keep it from that for now.
fn checkpoint(connection: &Connection) {
    let done = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
    if let Err(error) = done {
        tracing::debug!(%error, "checkpoint");
    }
}
