//! Deletion: days of windows that are too old, and the oldest rows of tables that only grow.

use std::path::{Path, PathBuf};

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
    /// Windows whose samples went to make room for newer ones.
    pub thinned: u64,
}

/// Files that were deleted.
#[derive(Debug, Default)]
pub(crate) struct Deleted {
    paths: Vec<PathBuf>,
    bytes: u64,
}

impl Deleted {
    fn add(&mut self, path: PathBuf, bytes: u64) {
        self.paths.push(path);
        self.bytes += bytes;
    }
}

impl Store {
    /// Deletes days of windows that are too old, today's never; thins windows that are too many (thinning.rs); drops samples that tell
    /// nothing, where the settings say so; brings the databases' logs into them, so that sizes are honest.
    ///
    /// # Errors
    /// What the database or the operating system reports; what was deleted until then is deleted.
    pub fn collect_garbage(&mut self) -> Result<Collected, StoreError> {
        let mut collected = Collected::default();
        self.grow_older()?;
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
        let Deleted {
            mut paths,
            mut bytes,
        } = self.delete_by_age()?;
        let thinned = self.figures().thinned;
        self.make_room()?;
        // What thinning gave back is in the logs until then.
        for day in self.days.each() {
            checkpoint(&day.connection);
        }
        self.measure_other_days()?;
        let Deleted {
            paths: oldest,
            bytes: of_oldest,
        } = std::mem::take(&mut self.deleted);
        paths.extend(oldest);
        bytes += of_oldest;
        (collected.deleted, collected.bytes) = (paths, bytes);
        collected.thinned = self.figures().thinned - thinned;
        collected.bytes_left = self.other_days_bytes + folder::size(&self.path_of_today());
        self.tell_what_no_fleet_gets()?;
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

    /// Deletes days that are older than the settings say, today's never. Age is time in use: no clock makes a day old.
    pub(crate) fn delete_by_age(&mut self) -> Result<Deleted, StoreError> {
        let mut deleted = Deleted::default();
        let today = clock::day(self.now());
        self.age_of(&today)?;
        let Some(days) = self.settings().retention.max_age_days else {
            return Ok(deleted);
        };
        // The day itself, and so many more.
        let most_ms = i64::from(days).saturating_add(1).saturating_mul(DAY_MS);
        for (day, path) in self.by_age(&today)? {
            if self.age_of(&day)? >= most_ms {
                deleted.add(path.clone(), self.delete_day(&day, &path)?);
            }
        }
        Ok(deleted)
    }

    /// Deletes the oldest file that is not today's and that `which` takes; false where there is none.
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
        self.tell_lost_to_fleet(day)?;
        self.days.close(path);
        self.tallies.remove(day);
        let freed = folder::delete(path)?;
        self.other_days_bytes = self.other_days_bytes.saturating_sub(freed);
        if !folder::of_day(self.folder(), day).exists() {
            self.forget_age_of(day)?;
        }
        tracing::info!(file = %path.display(), bytes = freed, "deleted: retention");
        Ok(freed)
    }

    /// A day that goes before a fleet has got all of it is told.
    fn tell_lost_to_fleet(&mut self, day: &str) -> Result<(), StoreError> {
        // A damaged one tells nothing.
        match self.count_due_of(day).unwrap_or(0) {
            0 => Ok(()),
            lost => self.tell_lost(day, lost),
        }
    }

    /// Windows whose samples went before a fleet had them are told, for each day.
    fn tell_what_no_fleet_gets(&mut self) -> Result<(), StoreError> {
        for (day, lost) in std::mem::take(&mut self.lost_to_fleet) {
            self.tell_lost(&day, lost)?;
        }
        Ok(())
    }

    fn tell_lost(&mut self, day: &str, lost: u64) -> Result<(), StoreError> {
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

    pub(crate) fn today_bytes(&self) -> Result<u64, StoreError> {
        let path = self.path_of_today();
        let today = self.days.today.as_ref();
        match today.filter(|day| day.file.path == path) {
            Some(day) => day.used_bytes(),
            None => Ok(folder::size(&path)),
        }
    }
}

/// Brings a database's log into it. A reader may keep it from that for now.
pub(crate) fn checkpoint(connection: &Connection) {
    let done = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
    if let Err(error) = done {
        tracing::debug!(%error, "checkpoint");
    }
}
