//! The store's folder: names of its files, the writer's lock, and damaged files that are set aside.

use std::fs::{self, File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::StoreError;
use super::clock::is_day;

/// Database of everything but the windows.
pub const RECORDS: &str = "ihd.db";

/// Folder of backups that the daemon makes, in the store's.
pub const BACKUPS: &str = "backups";

/// Lock file of the process that writes.
const LOCK: &str = "ihd.lock";

/// Text between a damaged file's name and the time at which it was set aside.
const DAMAGED: &str = ".damaged-";

/// Endings of SQLite's files beside a database.
const BESIDE: [&str; 2] = ["-wal", "-shm"];

/// Ending of the name that a database has until its tables are on disk.
pub(crate) const MAKING: &str = ".new";

/// A damaged file that was set aside.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DamagedFile {
    /// Path before.
    pub from: PathBuf,
    /// Path now.
    pub to: PathBuf,
    /// Description of the fault.
    pub why: String,
}

/// Database file of one day of windows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DayFile {
    /// `YYYY-MM-DD`, in UTC.
    pub day: String,
    /// The database.
    pub path: PathBuf,
}

/// Returns the path of a day's database.
pub fn of_day(folder: &Path, day: &str) -> PathBuf {
    folder.join(format!("windows-{day}.db"))
}

/// Returns every day with windows, oldest first.
///
/// # Errors
/// Errors of the operating system.
pub fn days(folder: &Path) -> Result<Vec<DayFile>, StoreError> {
    let mut days = Vec::new();
    for name in names(folder)? {
        let day = name
            .strip_prefix("windows-")
            .and_then(|rest| rest.strip_suffix(".db"))
            .filter(|day| is_day(day));
        days.extend(day.map(|day| DayFile {
            day: day.to_owned(),
            path: folder.join(&name),
        }));
    }
    days.sort();
    Ok(days)
}

/// Returns the damaged databases of windows that were set aside, oldest day first.
///
/// # Errors
/// Errors of the operating system.
pub fn damaged_days(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let mut names: Vec<PathBuf> = names(folder)?
        .into_iter()
        .filter(|name| name.starts_with("windows-") && name.contains(DAMAGED))
        .filter(|name| !BESIDE.iter().any(|beside| name.ends_with(beside)))
        .map(|name| folder.join(name))
        .collect();
    names.sort();
    Ok(names)
}

/// Returns the names of all damaged databases that were set aside.
///
/// # Errors
/// Errors of the operating system.
pub fn set_aside_names(folder: &Path) -> Result<Vec<String>, StoreError> {
    let mut names = names(folder)?;
    names.retain(|name| name.contains(DAMAGED) && !BESIDE.iter().any(|b| name.ends_with(b)));
    names.sort();
    Ok(names)
}

fn names(folder: &Path) -> Result<Vec<String>, StoreError> {
    let reading = || StoreError::files(folder, "reading the folder");
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(reading())? {
        let name = entry.map_err(reading())?.file_name();
        names.extend(name.into_string());
    }
    Ok(names)
}

/// Returns `true` if a database of windows gives no room back to the disk when its windows are thinned: one of an earlier ihd, or one that
/// was set aside. One that cannot be read may be any.
pub fn cannot_shrink(path: &Path) -> bool {
    // The header's field "incremental vacuum mode": https://sqlite.org/fileformat2.html
    let mut header = [0; 68];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut header));
    let is_set_aside = path.extension().is_none_or(|ending| ending != "db");
    is_set_aside || (read.is_ok() && header[64..68] == [0; 4])
}

/// Returns the bytes of a database with SQLite's log beside it; 0 if it does not exist.
pub fn size(path: &Path) -> u64 {
    let length = |path: &Path| fs::metadata(path).map_or(0, |about| about.len());
    length(path) + length(&beside(path, "-wal"))
}

/// Returns the path with an ending after its name.
pub fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Deletes a database with SQLite's files beside it; returns the bytes that it took.
///
/// # Errors
/// Errors of the operating system.
pub fn delete(path: &Path) -> Result<u64, StoreError> {
    let bytes = size(path);
    let deleting = || StoreError::files(path, "deleting");
    match fs::metadata(path) {
        Ok(about) if about.is_dir() => fs::remove_dir_all(path).map_err(deleting())?,
        _ => fs::remove_file(path).map_err(deleting())?,
    }
    for ending in BESIDE {
        remove_if_there(&beside(path, ending))?;
    }
    Ok(bytes)
}

fn remove_if_there(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(StoreError::files(path, "deleting")(error))
        }
        _ => Ok(()),
    }
}

/// Removes half-made databases, and SQLite's files beside databases that are gone: they would be taken for those of a
/// new one.
///
/// # Errors
/// Errors of the operating system.
pub fn remove_orphans(folder: &Path) -> Result<(), StoreError> {
    let unfinished = format!(".db{MAKING}");
    for name in names(folder)? {
        if name.ends_with(&unfinished) {
            delete(&folder.join(&name))?;
        }
        for ending in BESIDE {
            let Some(database) = name.strip_suffix(ending) else {
                continue;
            };
            let path = folder.join(&name);
            let is_ours = database.ends_with(".db") || database.ends_with(&unfinished);
            if is_ours && !folder.join(database).exists() && path.is_file() {
                remove_if_there(&path)?;
            }
        }
    }
    Ok(())
}

/// Renames a damaged database and SQLite's files beside it, so that it is not used any more and nothing is
/// lost.
///
/// # Errors
/// Errors of the operating system.
pub fn set_aside(path: &Path, why: String, at_ms: i64) -> Result<DamagedFile, StoreError> {
    let to = free_name(path, at_ms);
    let moving = || StoreError::files(path, "setting the damaged file aside");
    if path.exists() {
        fs::rename(path, &to).map_err(moving())?;
    }
    // The log may hold the last commits.
    let log = beside(path, "-wal");
    if log.exists() {
        fs::rename(&log, beside(&to, "-wal")).map_err(moving())?;
    }
    let shared = beside(path, "-shm");
    if shared.is_dir() {
        fs::rename(&shared, beside(&to, "-shm")).map_err(moving())?;
    } else {
        remove_if_there(&shared)?;
    }
    if let Some(folder) = path.parent() {
        ihd_signal::atomic::synchronise_folder(folder).map_err(moving())?;
    }
    let from = path.to_owned();
    Ok(DamagedFile { from, to, why })
}

/// Returns `NAME.damaged-20261122T083000Z`, with a number behind it if that exists.
fn free_name(path: &Path, at_ms: i64) -> PathBuf {
    let at: String = super::clock::rfc3339(at_ms)
        .chars()
        .take_while(|c| *c != '.')
        .filter(|c| !matches!(c, '-' | ':'))
        .collect();
    let first = beside(path, &format!("{DAMAGED}{at}Z"));
    (1..)
        .map(|n| match n {
            1 => first.clone(),
            _ => beside(&first, &format!("-{n}")),
        })
        .find(|name| !name.exists() && !beside(name, "-wal").exists())
        .unwrap_or(first)
}

/// Lock for writing, held until it is dropped. The operating system releases it when the process ends.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

impl Lock {
    /// Locks the folder and writes the process's id into the lock file.
    ///
    /// # Errors
    /// [`StoreError::InUse`], or an error of the operating system.
    pub fn take(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(LOCK);
        let failed = || StoreError::files(&path, "locking the store");
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(failed())?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(in_use(folder, &mut file)),
            Err(TryLockError::Error(error)) => return Err(failed()(error)),
        }
        // On a full disk the id is missing; the lock holds all the same.
        let _ = file
            .set_len(0)
            .and_then(|()| write!(file, "{}", std::process::id()));
        Ok(Self { _file: file })
    }
}

fn in_use(folder: &Path, file: &mut File) -> StoreError {
    let mut text = String::new();
    let read = file
        .rewind()
        .and_then(|()| file.take(16).read_to_string(&mut text));
    let process = read.ok().and_then(|_| text.trim().parse::<u32>().ok());
    StoreError::InUse {
        folder: folder.to_owned(),
        holder: process.map_or(String::new(), |p| format!(" (process {p})")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_whose_header_cannot_be_read_may_shrink() {
        let folder = tempfile::tempdir().unwrap();
        let day = of_day(folder.path(), "2026-11-22");
        assert!(!cannot_shrink(&day), "it is not there");
        let mut header = [0; 100];
        fs::write(&day, header).unwrap();
        assert!(cannot_shrink(&day));
        header[67] = 1;
        fs::write(&day, header).unwrap();
        assert!(!cannot_shrink(&day));
        // Opened, and not read.
        let unreadable = of_day(folder.path(), "2026-11-21");
        fs::create_dir(&unreadable).unwrap();
        assert!(!cannot_shrink(&unreadable));
        let set_aside = beside(&unreadable, ".damaged-20261122T000000Z");
        assert!(cannot_shrink(&set_aside));
    }
}
