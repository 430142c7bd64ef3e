//! Atomic writing of files: a file has either its old or its new content.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Number of files written by this process, which makes names of temporary files unique.
static WRITTEN: AtomicU32 = AtomicU32::new(0);

/// Replaces a file atomically, even if the process or the power fails meanwhile: a temporary file in the same folder, fsync,
/// rename, fsync of the folder.
///
/// # Errors
/// Error of the operating system; the old file is then unchanged, and the temporary one removed.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let (replacement, mut file) = Replacement::create(path.to_owned())?;
    file.write_all(bytes)?;
    replacement.complete()
}

/// Renames a file durably: the folder of the new name is synchronised.
///
/// # Errors
/// Error of the operating system.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    synchronise_folder(folder_of(to))
}

/// Makes created, renamed and removed entries of a folder durable. Does nothing except on Unix.
///
/// # Errors
/// Error of the operating system.
pub fn synchronise_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

/// File that takes its name when it is complete. Dropped before that, it leaves nothing, and an older file of the name as it was. On
/// Linux it has no name until then, where the file system allows it, so that a killed process leaves nothing either; else a temporary
/// one beside its own.
#[derive(Debug)]
pub struct Replacement {
    path: PathBuf,
    /// Temporary name; `None` once there is none to remove, or if the file is written in place.
    temporary: Option<PathBuf>,
    /// File without a name.
    nameless: Option<File>,
}

impl Replacement {
    /// Opens the temporary file. A link is followed; what is no regular file, as a device or a pipe, is written in place.
    ///
    /// # Errors
    /// Error of the operating system; also for an older file that may not be written, which a renaming would replace.
    pub fn begin(path: &Path) -> io::Result<(Self, File)> {
        let older = OpenOptions::new().write(true).open(path);
        let older = match older {
            Ok(file) => Some((file.metadata()?, file)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => None,
            Err(e) => return Err(e),
        };
        let mut permissions = None;
        let mut path = path.to_owned();
        if let Some((metadata, file)) = older {
            if !metadata.is_file() {
                let in_place = Self {
                    path,
                    temporary: None,
                    nameless: None,
                };
                return Ok((in_place, file));
            }
            path = path.canonicalize()?;
            permissions = Some(metadata.permissions());
        }
        // A link to a file that does not exist yet; opening has refused a circle of links.
        while let Ok(target) = fs::read_link(&path) {
            path = folder_of(&path).join(target);
        }
        let (begun, file) = match nameless(folder_of(&path)) {
            Some(file) => {
                let begun = Self {
                    path,
                    temporary: None,
                    nameless: Some(file.try_clone()?),
                };
                (begun, file)
            }
            None => Self::create(path)?,
        };
        if let Some(permissions) = permissions {
            file.set_permissions(permissions)?;
        }
        Ok((begun, file))
    }

    fn create(path: PathBuf) -> io::Result<(Self, File)> {
        let temporary = beside(&path)?;
        let file = File::create_new(&temporary)?;
        let begun = Self {
            path,
            temporary: Some(temporary),
            nameless: None,
        };
        Ok((begun, file))
    }

    /// Gives the file, which is completely written, its name.
    ///
    /// # Errors
    /// Error of the operating system; the older file is then unchanged, and the temporary one removed.
    pub fn complete(mut self) -> io::Result<()> {
        if let Some(file) = &self.nameless {
            file.sync_all()?;
            let temporary = beside(&self.path)?;
            name(file, &temporary)?;
            self.temporary = Some(temporary);
        }
        let Some(temporary) = &self.temporary else {
            return Ok(());
        };
        OpenOptions::new().write(true).open(temporary)?.sync_all()?;
        rename(temporary, &self.path)?;
        self.temporary = None;
        Ok(())
    }
}

impl Drop for Replacement {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // Nobody can be told.
            let _ = fs::remove_file(temporary);
        }
    }
}

/// Writes a file that a user names, as [`Replacement`] does.
///
/// # Errors
/// Any error of [`Replacement::begin`] and [`Replacement::complete`].
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let (replacement, mut file) = Replacement::begin(path)?;
    file.write_all(bytes)?;
    replacement.complete()
}

/// File without a name in a folder; `None` where it could not be given one later.
#[cfg(target_os = "linux")]
fn nameless(folder: &Path) -> Option<File> {
    use nix::fcntl::{OFlag, open};
    use nix::sys::stat::Mode;
    let flags = OFlag::O_TMPFILE | OFlag::O_RDWR | OFlag::O_CLOEXEC;
    let file = open(folder, flags, Mode::from_bits_truncate(0o666)).ok()?;
    let file = File::from(file);
    link_of(&file).exists().then_some(file)
}

#[cfg(target_os = "linux")]
fn link_of(file: &File) -> PathBuf {
    use std::os::fd::AsRawFd;
    PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

/// Gives a file without a name one.
#[cfg(target_os = "linux")]
fn name(file: &File, path: &Path) -> io::Result<()> {
    use nix::fcntl::{AT_FDCWD, AtFlags};
    let follow = AtFlags::AT_SYMLINK_FOLLOW;
    Ok(nix::unistd::linkat(
        AT_FDCWD,
        link_of(file).as_path(),
        AT_FDCWD,
        path,
        follow,
    )?)
}

#[cfg(not(target_os = "linux"))]
fn nameless(_folder: &Path) -> Option<File> {
    None
}

#[cfg(not(target_os = "linux"))]
fn name(_file: &File, _path: &Path) -> io::Result<()> {
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn beside(path: &Path) -> io::Result<PathBuf> {
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let mut temporary = std::ffi::OsString::from(".");
    temporary.push(name);
    let n = WRITTEN.fetch_add(1, Ordering::Relaxed);
    temporary.push(format!(".{}-{n}.tmp", std::process::id()));
    Ok(path.with_file_name(temporary))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("ihd-atomic-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let folder = folder("replaced");
        let path = folder.join("a.bin");
        write(&path, b"old").unwrap();
        write(&path, b"new bytes").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new bytes");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_cannot_be_written_leaves_the_old_file_and_nothing_else() {
        let folder = folder("refused");
        let path = folder.join("a");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("kept"), b"x").unwrap();
        assert!(write(&path, b"bytes").is_err());
        assert_eq!(fs::read(path.join("kept")).unwrap(), b"x");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        assert!(write(Path::new("/"), b"").is_err());
        assert!(write(&folder.join("none/a"), b"").is_err());
        fs::remove_dir_all(&folder).unwrap();
    }

    /// A user's file keeps its old bytes until the new ones are complete; a link and a device stay what they are.
    #[test]
    fn a_replacement_that_is_not_completed_changes_nothing() {
        let folder = folder("replacement");
        let path = folder.join("a.csv");
        fs::write(&path, b"old").unwrap();
        for path in [&path, &folder.join("new.csv")] {
            let (replacement, mut file) = Replacement::begin(path).unwrap();
            file.write_all(b"half").unwrap();
            drop(replacement);
        }
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        replace(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        assert!(replace(&folder, b"").is_err());
        #[cfg(unix)]
        {
            let link = folder.join("link.csv");
            std::os::unix::fs::symlink("a.csv", &link).unwrap();
            replace(&link, b"newer").unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"newer");
            fs::remove_file(&path).unwrap();
            replace(&link, b"first").unwrap();
            assert!(link.symlink_metadata().unwrap().is_symlink());
            assert_eq!(fs::read(&path).unwrap(), b"first");
            let null = folder.join("null.csv");
            std::os::unix::fs::symlink("/dev/null", &null).unwrap();
            replace(&null, b"bytes").unwrap();
            assert!(null.symlink_metadata().unwrap().is_symlink());
            assert_eq!(fs::read_dir(&folder).unwrap().count(), 3);
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    /// ^C and kill run no destructor: 61 MB of a hidden file stayed.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_killed_process_leaves_nothing() {
        let folder = folder("killed");
        let (replacement, mut file) = Replacement::begin(&folder.join("a.csv")).unwrap();
        file.write_all(b"half").unwrap();
        std::mem::forget(replacement);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        fs::remove_dir_all(&folder).unwrap();
    }

    /// A reader sees the old bytes or the new ones, never a part.
    #[test]
    fn a_reader_never_sees_a_part() {
        let folder = folder("reader");
        let path = folder.join("a");
        write(&path, &[0; 100_000]).unwrap();
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| {
                for k in 1..=50 {
                    write(&path, &[k; 100_000]).unwrap();
                }
            });
            while !writer.is_finished() {
                let bytes = fs::read(&path).unwrap();
                assert_eq!(bytes.len(), 100_000);
                assert!(bytes.iter().all(|b| *b == bytes[0]));
            }
        });
        fs::remove_dir_all(&folder).unwrap();
    }
}
