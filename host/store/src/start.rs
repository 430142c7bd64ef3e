//! Opening of the store: one writer, checked databases, damaged ones set aside.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::Connection;

use super::backup;
use super::clock::{self, Clock};
use super::database::{self, IntegrityCheck};
use super::folder::{self, DamagedFile, Lock};
use super::schema::{RECORDS, Schema, WINDOWS};
use super::{Store, StoreError, StoreOptions};

/// Time limit of the check of `ihd.db` at a start.
const CHECK_RECORDS: Duration = Duration::from_secs(30);

/// Time limit of the checks of all days of windows at a start, newest first.
const CHECK_WINDOWS: Duration = Duration::from_secs(20);

/// An opened store with the damage found.
pub struct OpenedStore {
    /// The store.
    pub store: Store,
    /// Damaged files that were set aside.
    pub damage: Vec<DamagedFile>,
}

impl Store {
    /// Opens the store in a folder, which is created if it does not exist, and locks it for writing.
    /// Each database is checked; a damaged one is set aside and reported, and the store continues with a new
    /// one. A full disk or a lock of another process leaves checks and ends of sessions for later.
    ///
    /// # Errors
    /// [`StoreError::InUse`] if another process has the store, [`StoreError::Newer`] if a later ihd
    /// wrote it, or an error of the database or the operating system.
    pub fn open(folder: &Path, options: &StoreOptions) -> Result<OpenedStore, StoreError> {
        Self::open_with_clock(folder, options, clock::of_the_machine())
    }

    /// Opens the store with another clock than the machine's; see [`Store::open`].
    ///
    /// # Errors
    /// The same as for [`Store::open`].
    pub fn open_with_clock(
        folder: &Path,
        options: &StoreOptions,
        clock: Clock,
    ) -> Result<OpenedStore, StoreError> {
        fs::create_dir_all(folder).map_err(StoreError::files(folder, "making the folder"))?;
        let lock = Lock::take(folder)?;
        folder::remove_orphans(folder)?;
        backup::remove_leftovers(&folder.join(folder::BACKUPS));
        let mut damage = Vec::new();
        let at_ms = clock();
        let path = folder.join(folder::RECORDS);
        let (records, _) = whole(&path, &RECORDS, CHECK_RECORDS, at_ms, &mut damage)?;
        check_days(folder, at_ms, &mut damage)?;
        let mut store = Store::new(folder, options, clock, records, lock)?;
        store.find_sessions_that_were_cut_off()?;
        log_passing_error(store.end_sessions_that_were_cut_off())?;
        log_passing_error(store.resume_recent())?;
        for file in &damage {
            log_passing_error(store.event(None, "damage", &describe(file)))?;
        }
        Ok(OpenedStore { store, damage })
    }
}

/// Logs an error that may pass by itself: a store that starts without this step can make room.
fn log_passing_error(done: Result<(), StoreError>) -> Result<(), StoreError> {
    match done {
        Err(error) if error.may_pass() => {
            tracing::warn!(%error, "store: left for later");
            Ok(())
        }
        done => done,
    }
}

/// Describes a damaged file in a sentence: its name, its place now, and the fault.
pub(crate) fn describe(damage: &DamagedFile) -> String {
    let DamagedFile { from, to, why } = damage;
    format!(
        "{} is damaged ({why}); set aside as {}",
        from.display(),
        to.display()
    )
}

fn check_days(folder: &Path, at_ms: i64, damage: &mut Vec<DamagedFile>) -> Result<(), StoreError> {
    let began = Instant::now();
    for day in folder::days(folder)?.iter().rev() {
        let left = CHECK_WINDOWS.saturating_sub(began.elapsed());
        let before = damage.len();
        let (connection, integrity) = match whole(&day.path, &WINDOWS, left, at_ms, damage) {
            Err(error) if error.may_pass() => {
                tracing::warn!(%error, "store: a day that is not checked");
                continue;
            }
            checked => checked?,
        };
        drop(connection);
        if damage.len() > before {
            // No windows of that day are left: no file is clearer than an empty one.
            folder::delete(&day.path)?;
        }
        if integrity == IntegrityCheck::TimedOut {
            tracing::warn!(file = %day.path.display(), "too long to check at a start; `ihd store check` checks it whole");
        }
    }
    Ok(())
}

/// Opens a database that passes the check: this one, or a new one in its place.
fn whole(
    path: &Path,
    schema: &Schema,
    within: Duration,
    at_ms: i64,
    damage: &mut Vec<DamagedFile>,
) -> Result<(Connection, IntegrityCheck), StoreError> {
    let why = match checked(path, schema, within) {
        Ok((connection, integrity @ (IntegrityCheck::Ok | IntegrityCheck::TimedOut))) => {
            return Ok((connection, integrity));
        }
        Ok((_, IntegrityCheck::Corrupt(why))) | Err(StoreError::Damaged { why, .. }) => why,
        Err(error) => return Err(error),
    };
    let set_aside = folder::set_aside(path, why, at_ms)?;
    tracing::error!("{}", describe(&set_aside));
    damage.push(set_aside);
    Ok((database::open(path, schema)?, IntegrityCheck::Ok))
}

fn checked(
    path: &Path,
    schema: &Schema,
    within: Duration,
) -> Result<(Connection, IntegrityCheck), StoreError> {
    let connection = database::open(path, schema)?;
    let integrity = database::quick_check(&connection, path, within)?;
    Ok((connection, integrity))
}
