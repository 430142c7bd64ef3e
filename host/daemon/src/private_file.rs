//! Files for their owner only.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::Path;

/// Creates a file that only its owner may read, from its creation on.
///
/// # Errors
/// Error of the operating system; also if the file exists.
pub fn create_private(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// Returns the permission bits of a file that others than its owner may read or write; `None` for its owner's alone. On systems other than
/// Unix the folder's access list must restrict access (docs/daemon.md).
///
/// # Errors
/// Error of the operating system.
pub fn mode_open_to_others(file: &File) -> io::Result<Option<u32>> {
    #[cfg(unix)]
    let mode = std::os::unix::fs::MetadataExt::mode(&file.metadata()?) & 0o777;
    #[cfg(not(unix))]
    let mode = file.metadata().map(|_| 0)?;
    Ok((mode & 0o077 != 0).then_some(mode))
}
