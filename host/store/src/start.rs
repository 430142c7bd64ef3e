//! Opening the store: one writer, whole databases, damaged ones set aside.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::Connection;

use super::backup;
use super::clock::{self, Clock};
use super::database::{self, Found};
use super::folder::{self, Damage, Lock};
use super::schema::{RECORDS, Schema, WINDOWS};
use super::{Settings, Store, StoreError};

/// How long the check of `ihd.db` may take at a start.
const CHECK_RECORDS: Duration = Duration::from_secs(30);

/// How long the checks of all days of windows may take at a start, newest first.
const CHECK_WINDOWS: Duration = Duration::from_secs(20);

/// What a start gives.
pub struct Opened {
    /// The store.
    pub store: Store,
    /// Files that were damaged, and set aside.
    pub damage: Vec<Damage>,
}

impl Store {
    /// Opens the store in a folder, which is made where there is none, and takes the right to write to it.
    /// Each database is checked; a damaged one is set aside and reported, and the store goes on with a new
    /// one.
    ///
    /// # Errors
    /// [`StoreError::InUse`] where another process has the store, [`StoreError::Newer`] where a later ihd
    /// wrote it, else what the database or the operating system reports.
    pub fn open(folder: &Path, settings: &Settings) -> Result<Opened, StoreError> {
        Self::open_with_clock(folder, settings, clock::of_the_machine())
    }

    /// As [`Store::open`], with another clock than the machine's.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open_with_clock(
        folder: &Path,
        settings: &Settings,
        clock: Clock,
    ) -> Result<Opened, StoreError> {
        fs::create_dir_all(folder).map_err(StoreError::files(folder, "making the folder"))?;
        let lock = Lock::take(folder)?;
        folder::remove_orphans(folder)?;
        backup::remove_leftovers(&folder.join(folder::BACKUPS));
        let mut damage = Vec::new();
        let at_ms = clock();
        let path = folder.join(folder::RECORDS);
        let (records, _) = whole(&path, &RECORDS, CHECK_RECORDS, at_ms, &mut damage)?;
        check_days(folder, at_ms, &mut damage)?;
        let mut store = Store::new(folder, settings, clock, records, lock)?;
        store.end_sessions_that_were_cut_off()?;
        store.resume_recent()?;
        for found in &damage {
            store.event(None, "damage", &in_words(found))?;
        }
        Ok(Opened { store, damage })
    }
}

/// What was damaged, where it is now, and why, in a sentence.
pub(crate) fn in_words(damage: &Damage) -> String {
    let Damage { from, to, why } = damage;
    format!(
        "{} is damaged ({why}); set aside as {}",
        from.display(),
        to.display()
    )
}

fn check_days(folder: &Path, at_ms: i64, damage: &mut Vec<Damage>) -> Result<(), StoreError> {
    let began = Instant::now();
    for day in folder::days(folder)?.iter().rev() {
        let left = CHECK_WINDOWS.saturating_sub(began.elapsed());
        let before = damage.len();
        let (connection, found) = whole(&day.path, &WINDOWS, left, at_ms, damage)?;
        drop(connection);
        if damage.len() > before {
            // No windows of that day are left: an empty file says so less well than none.
            folder::delete(&day.path)?;
        }
        if found == Found::Unfinished {
            tracing::warn!(file = %day.path.display(), "too long to check at a start; `ihd store check` checks it whole");
        }
    }
    Ok(())
}

/// Opens a database that is whole: this one, or a new one in its place.
fn whole(
    path: &Path,
    schema: &Schema,
    within: Duration,
    at_ms: i64,
    damage: &mut Vec<Damage>,
) -> Result<(Connection, Found), StoreError> {
    let why = match checked(path, schema, within) {
        Ok((connection, found @ (Found::Whole | Found::Unfinished))) => {
            return Ok((connection, found));
        }
        Ok((_, Found::Broken(why))) | Err(StoreError::Damaged { why, .. }) => why,
        Err(error) => return Err(error),
    };
    let found = folder::set_aside(path, why, at_ms)?;
    tracing::error!("{}", in_words(&found));
    damage.push(found);
    Ok((database::open(path, schema)?, Found::Whole))
}

fn checked(
    path: &Path,
    schema: &Schema,
    within: Duration,
) -> Result<(Connection, Found), StoreError> {
    let connection = database::open(path, schema)?;
    let found = database::quick_check(&connection, path, within)?;
    Ok((connection, found))
}
