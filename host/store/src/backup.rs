//! Backup: a copy of the store, also while another process writes to it.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};

use super::folder::{self, RECORDS, beside};
use super::schema;
use super::windows::Day;
use super::{StoreError, database};

/// Copies a store to a new folder by SQLite's online backup; other processes may write meanwhile. Results are copied first, so that the
/// copy holds every window that they refer to, unless retention has deleted it. The folder gets its name when all of it is on disk.
///
/// # Errors
/// [`StoreError::Exists`] if the folder exists, [`StoreError::NoStore`], or an error of the database or the operating system. An
/// incomplete copy is removed; if this process is killed, by the next backup or start.
pub fn backup(from: &Path, to: &Path) -> Result<(), StoreError> {
    if fs::symlink_metadata(to).is_ok() {
        let path = to.to_owned();
        return Err(StoreError::Exists { path });
    }
    if !from.join(RECORDS).is_file() {
        let folder = from.to_owned();
        return Err(StoreError::NoStore { folder });
    }
    let partial = Partial::begin(to)?;
    into_folder(from, &partial.folder)?;
    ihd_signal::atomic::rename(&partial.folder, to).map_err(StoreError::files(to, "renaming"))
}

/// Ending of a folder that is being filled; its name begins with a dot, which no backup's does.
const PARTIAL: &str = ".partial";

/// Ending of the file beside it that is locked meanwhile.
const LOCK: &str = ".lock";

/// Number that distinguishes the backups of one process.
static BEGUN: AtomicU32 = AtomicU32::new(0);

/// A backup that is being filled, under a name of its own; removed unless it was renamed.
struct Partial {
    folder: PathBuf,
    lock: PathBuf,
    /// Held until its process ends.
    _held: File,
}

impl Partial {
    /// Starts a backup beside `to`, and removes those that killed processes left there.
    fn begin(to: &Path) -> Result<Self, StoreError> {
        let parent = match to.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        fs::create_dir_all(parent).map_err(StoreError::files(parent, "making the folder"))?;
        remove_leftovers(parent);
        let name = to.file_name().unwrap_or_default().to_string_lossy();
        let (process, n) = (std::process::id(), BEGUN.fetch_add(1, Ordering::Relaxed));
        let folder = parent.join(format!(".{name}.{process}-{n}{PARTIAL}"));
        let lock = beside(&folder, LOCK);
        let begun = File::create(&lock).and_then(|held| {
            held.try_lock()?;
            fs::create_dir(&folder)?;
            Ok(held)
        });
        let held = begun.map_err(StoreError::files(&folder, "making the folder"))?;
        Ok(Self {
            folder,
            lock,
            _held: held,
        })
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // Gone after a renaming. If it cannot be removed, the next backup tries again and reports it.
        let _ = fs::remove_dir_all(&self.folder);
        let _ = fs::remove_file(&self.lock);
    }
}

/// Removes unfinished backups whose process is gone from a folder of backups.
pub(crate) fn remove_leftovers(backups: &Path) {
    let Ok(entries) = fs::read_dir(backups) else {
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if !name.starts_with('.') || !name.ends_with(&format!("{PARTIAL}{LOCK}")) {
            continue;
        }
        let free = File::open(&path).is_ok_and(|file| file.try_lock().is_ok());
        let partial = path.with_extension("");
        if free {
            if partial.exists() {
                tracing::warn!(folder = %partial.display(), "removed: a backup that was not finished");
            }
            let gone = fs::remove_dir_all(&partial).is_ok() || !partial.exists();
            if gone {
                let _ = fs::remove_file(&path);
            }
        }
    }
}

fn into_folder(from: &Path, to: &Path) -> Result<(), StoreError> {
    let source = database::open_to_read(&from.join(RECORDS), &schema::RECORDS)?;
    copy(&source, &to.join(RECORDS))?;
    for file in folder::days(from)? {
        if let Some(Day { file, connection }) = Day::open_to_read(file)? {
            copy(&connection, &folder::of_day(to, &file.day))?;
        }
    }
    ihd_signal::atomic::synchronise_folder(to).map_err(StoreError::files(to, "synchronising"))
}

/// Copies all pages in one step, so that the copy is a consistent state; the source's writer is not blocked.
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
