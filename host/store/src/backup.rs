//! A copy of the store while it is written.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};

use super::folder::{self, RECORDS};
use super::schema;
use super::{Store, StoreError, database};

impl Store {
    /// As [`backup`].
    ///
    /// # Errors
    /// As [`backup`].
    pub fn backup(&self, to: &Path) -> Result<(), StoreError> {
        backup(self.folder(), to)
    }
}

/// Copies a store to a new folder, whoever writes to it meanwhile, by SQLite's online backup. Results come
/// first: every window that they speak of is in the copy, unless retention deleted it meanwhile. The new
/// folder has its name when all of it is on disk, not before.
///
/// # Errors
/// [`StoreError::Exists`] where there is such a folder, [`StoreError::NoStore`], else what the database or
/// the operating system reports.
pub fn backup(from: &Path, to: &Path) -> Result<(), StoreError> {
    if fs::symlink_metadata(to).is_ok() {
        let path = to.to_owned();
        return Err(StoreError::Exists { path });
    }
    if !from.join(RECORDS).is_file() {
        let folder = from.to_owned();
        return Err(StoreError::NoStore { folder });
    }
    let mut name = to.as_os_str().to_owned();
    name.push(format!(".{}.partial", std::process::id()));
    let partial = PathBuf::from(name);
    let done = into_folder(from, &partial).and_then(|()| {
        ihd_signal::atomic::rename(&partial, to).map_err(StoreError::files(to, "renaming"))
    });
    if done.is_err() {
        // That it cannot be removed either is of no use here.
        let _ = fs::remove_dir_all(&partial);
    }
    done
}

fn into_folder(from: &Path, to: &Path) -> Result<(), StoreError> {
    fs::create_dir_all(to).map_err(StoreError::files(to, "making the folder"))?;
    let source = database::open_to_read(&from.join(RECORDS), &schema::RECORDS)?;
    copy(&source, &to.join(RECORDS))?;
    for day in folder::days(from)? {
        let source = match database::open_to_read(&day.path, &schema::WINDOWS) {
            // Deleted since the folder was read.
            Err(_) if !day.path.exists() => continue,
            opened => opened?,
        };
        copy(&source, &folder::of_day(to, &day.day))?;
    }
    ihd_signal::atomic::synchronise_folder(to).map_err(StoreError::files(to, "synchronising"))
}

/// All pages in one step, which is one moment of the source; its writer goes on beside it.
fn copy(source: &Connection, to: &Path) -> Result<(), StoreError> {
    let failed = || StoreError::database(to, "backing up");
    let mut target = Connection::open(to).map_err(failed())?;
    let backup = Backup::new(source, &mut target).map_err(failed())?;
    let step = backup.step(-1).map_err(failed())?;
    drop(backup);
    if step != StepResult::Done {
        let busy = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_BUSY);
        return Err(failed()(rusqlite::Error::SqliteFailure(busy, None)));
    }
    target.close().map_err(|(_, error)| failed()(error))?;
    let synced = File::open(to).and_then(|file| file.sync_all());
    synced.map_err(StoreError::files(to, "synchronising"))
}
