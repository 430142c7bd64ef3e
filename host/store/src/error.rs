//! Errors of the store.

use std::fs::{self, File};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;

/// Error of the store. The failed call has changed nothing.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another process writes to the store.
    #[error(
        "{}: another process{holder} uses this store; stop it, or give this one a folder of its own",
        folder.display()
    )]
    InUse {
        /// The store's folder.
        folder: PathBuf,
        /// ` (process 4711)`; empty if unknown.
        holder: String,
    },
    /// There is no store.
    #[error("{}: there is no store here (no ihd.db); --store or the configuration's `store` names its folder", folder.display())]
    NoStore {
        /// The folder.
        folder: PathBuf,
    },
    /// The database was written by a later ihd.
    #[error(
        "{}: version {version} of its tables, and this ihd knows {known}: use the ihd that wrote it, or a newer one",
        file.display()
    )]
    Newer {
        /// The database.
        file: PathBuf,
        /// Its version.
        version: i64,
        /// The latest known.
        known: i64,
    },
    /// The file is not a database of ihd, or it is corrupt.
    #[error("{}: damaged: {why}", file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Description of the fault.
        why: String,
    },
    /// The database reports an error.
    #[error("{}: {doing}: {source}", file.display())]
    Database {
        /// The database.
        file: PathBuf,
        /// Operation that failed.
        doing: &'static str,
        /// SQLite's error.
        source: rusqlite::Error,
        /// `true` if there is no room left.
        full: bool,
    },
    /// The operating system reports an error.
    #[error("{}: {doing}: {source}", file.display())]
    Files {
        /// The file or folder.
        file: PathBuf,
        /// Operation that failed.
        doing: &'static str,
        /// The operating system's error.
        source: io::Error,
    },
    /// There is no such session.
    #[error("there is no session {session} in the store")]
    NoSession {
        /// Its number.
        session: i64,
    },
    /// There is no such lookup.
    #[error("the store holds no lookup of version {version} of that device")]
    NoLookup {
        /// Its version.
        version: u32,
    },
    /// The lookup is in a state in which it cannot be refused.
    #[error("the lookup of version {version} is {state}, and cannot be refused")]
    LookupState {
        /// Its version.
        version: u32,
        /// Its state.
        state: super::LookupState,
    },
    /// A stored window cannot be unpacked.
    #[error("{}: window {seq} of {device:?} (boot {boot}): {why}", file.display())]
    Window {
        /// The day's file.
        file: PathBuf,
        /// The device's name.
        device: String,
        /// The device's boot.
        boot: u32,
        /// The window's number.
        seq: u32,
        /// Description of the fault.
        why: String,
    },
    /// The target exists already.
    #[error("{}: there is such a file already; nothing was written", path.display())]
    Exists {
        /// The existing file or folder.
        path: PathBuf,
    },
    /// One file was requested, and the windows make none or several.
    #[error(
        "{}: the windows asked for make {files} files, not one: name a folder, or narrow --device, --boot, --seq and --since",
        path.display()
    )]
    NotOneFile {
        /// The file.
        path: PathBuf,
        /// Number of files.
        files: usize,
    },
    /// A window could not be written as a capture.
    #[error(transparent)]
    Export(#[from] ihd_capture::exports::ExportError),
}

impl StoreError {
    /// Returns `true` if there was no room left: on the disk, in a quota, or for a file's size. The same call works
    /// when there is room again.
    pub fn is_full(&self) -> bool {
        match self {
            Self::Database { full, .. } => *full,
            Self::Files { source, .. } => is_full(source),
            _ => false,
        }
    }

    /// Returns `true` if a database is corrupt.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { .. } | Self::Window { .. } => true,
            Self::Database { source, .. } => is_damage(source),
            _ => false,
        }
    }

    /// Returns `true` if another connection kept the database locked for longer than a write waits.
    pub fn is_locked(&self) -> bool {
        use ErrorCode::{DatabaseBusy, DatabaseLocked};
        matches!(self.code(), Some(DatabaseBusy | DatabaseLocked))
    }

    /// Returns `true` if the same call may work later: there was no room, or the database was locked.
    pub(crate) fn may_pass(&self) -> bool {
        self.is_full() || self.is_locked()
    }

    /// Returns `true` if the files may not be written, or not opened.
    pub fn is_denied(&self) -> bool {
        use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
        match self {
            Self::Database { full: false, .. } => matches!(
                self.code(),
                Some(ErrorCode::PermissionDenied | ErrorCode::ReadOnly | ErrorCode::CannotOpen)
            ),
            Self::Files { source, .. } => {
                matches!(source.kind(), PermissionDenied | ReadOnlyFilesystem)
            }
            _ => false,
        }
    }

    /// Returns `true` if the databases or their disk failed; `false` if the request was wrong, such as one for a lookup that is not
    /// there.
    pub fn is_of_storage(&self) -> bool {
        matches!(
            self,
            Self::Database { .. } | Self::Files { .. } | Self::Damaged { .. }
        )
    }

    fn code(&self) -> Option<ErrorCode> {
        match self {
            Self::Database { source, .. } => source.sqlite_error_code(),
            _ => None,
        }
    }

    /// Returns the conversion of an error that occurred while `doing` something with `file`.
    pub(crate) fn database(
        file: &Path,
        doing: &'static str,
    ) -> impl FnOnce(rusqlite::Error) -> Self + use<> {
        let file = file.to_owned();
        move |source| {
            let full = match source.sqlite_error_code() {
                Some(ErrorCode::DiskFull) => true,
                // SQLite reports a full disk as such, but no quota, no limit of a
                // file's size, and no full disk if it cannot create its shared memory.
                Some(ErrorCode::SystemIoFailure | ErrorCode::CannotOpen) => has_no_room(&file),
                _ => false,
            };
            Self::Database {
                file,
                doing,
                source,
                full,
            }
        }
    }

    /// Returns the conversion of an error that occurred while `doing` something with `file`.
    pub(crate) fn files(
        file: &Path,
        doing: &'static str,
    ) -> impl FnOnce(io::Error) -> Self + use<> {
        let file = file.to_owned();
        move |source| Self::Files {
            file,
            doing,
            source,
        }
    }
}

/// Returns `true` if SQLite reports that the file is corrupt or not a database.
pub(crate) fn is_damage(error: &rusqlite::Error) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase)
    )
}

fn is_full(error: &io::Error) -> bool {
    use io::ErrorKind as K;
    matches!(
        error.kind(),
        K::StorageFull | K::QuotaExceeded | K::FileTooLarge
    )
}

/// Returns `true` if no file of this one's length and a few pages more can be written beside it.
fn has_no_room(file: &Path) -> bool {
    write_beside(file, 1 << 16).is_err_and(|error| is_full(&error))
}

/// Writes `bytes` bytes to a file beside this one, at the offset at which this one grows, and removes that file.
pub(crate) fn write_beside(file: &Path, bytes: usize) -> io::Result<()> {
    let length = |path: &Path| fs::metadata(path).map_or(0, |about| about.len());
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    let end = length(file).max(length(Path::new(&log)));
    let path = file.with_file_name(format!(".room-{}.tmp", std::process::id()));
    let tried = File::create(&path).and_then(|mut file| {
        // The hole before it takes no room.
        file.seek(SeekFrom::Start(end))?;
        file.write_all(&vec![0; bytes])?;
        file.sync_all()
    });
    // A failure to remove it does not concern the room.
    let _ = fs::remove_file(&path);
    tried
}
