//! Images that were flashed from here, kept by their build id: their texts are wanted when the board logs.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use ihd_signal::atomic;

use super::running::Running;
use crate::image::{BuildId, Image};

/// Images that are kept; the ones that were flashed longest ago go.
pub const MOST: usize = 24;

/// A folder of images.
#[derive(Clone, Debug)]
pub struct Kept {
    folder: PathBuf,
}

impl Kept {
    /// The user's own: `ihd/images` in the folder for data of programs. `None` where the user has none.
    pub fn of_user() -> Option<Self> {
        let folder = data_folder(|name| {
            let value = std::env::var_os(name).map(PathBuf::from)?;
            // As the XDG specification wants it: what is relative is ignored.
            value.is_absolute().then_some(value)
        })?;
        Some(Self::at(folder.join("ihd").join("images")))
    }

    /// In a folder, which need not be there.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Keeps an image, whole or not at all, and lets the oldest go.
    ///
    /// # Errors
    /// What the operating system reports.
    pub fn keep(&self, image: &Image) -> io::Result<PathBuf> {
        fs::create_dir_all(&self.folder)?;
        let path = self.path(&image.build_id);
        atomic::write(&path, image.elf())?;
        let mut kept = self.list();
        kept.sort_by_key(|path| fs::metadata(path).and_then(|file| file.modified()).ok());
        let too_many = kept.len().saturating_sub(MOST);
        // Where one cannot be removed, the next time will.
        for old in kept.iter().filter(|old| **old != path).take(too_many) {
            let _ = fs::remove_file(old);
        }
        Ok(path)
    }

    /// The image that runs, where it is kept and whole.
    pub fn find(&self, running: &Running) -> Option<Image> {
        let named = running.build_id.map(|id| self.path(&id));
        // Without a build id, each may be it.
        let paths = named.map_or_else(|| self.list(), |path| vec![path]);
        paths
            .iter()
            .filter_map(|path| Image::read(path).ok())
            .find(|image| running.is(image))
    }

    fn path(&self, id: &BuildId) -> PathBuf {
        self.folder.join(format!("{id}.elf"))
    }

    /// Files that are named as kept images are; nobody else's.
    fn list(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries
            .map(|entry| entry.path())
            .filter(|path| {
                let name = path.file_name().and_then(|name| name.to_str());
                let id = name.and_then(|name| name.strip_suffix(".elf"));
                id.is_some_and(|id| id.len() == 40 && id.bytes().all(|b| b.is_ascii_hexdigit()))
            })
            .collect()
    }
}

/// Where programs keep data of the user, by the variables of the operating system.
fn data_folder(variable: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    if cfg!(windows) {
        return variable("LOCALAPPDATA");
    }
    let home = || variable("HOME");
    if cfg!(target_os = "macos") {
        return Some(home()?.join("Library/Application Support"));
    }
    variable("XDG_DATA_HOME").or_else(|| Some(home()?.join(".local/share")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fake::SampleImage;

    fn image(build_id: u8) -> Image {
        let sample = SampleImage {
            build_id,
            ..SampleImage::default()
        };
        Image::parse(&sample.elf(), None).unwrap()
    }

    fn running(image: &Image) -> Running {
        Running {
            build_id: Some(image.build_id),
            ..Running::default()
        }
    }

    #[test]
    fn what_was_flashed_is_found_again_by_build_id_and_by_crc() {
        let folder = tempfile::tempdir().unwrap();
        let kept = Kept::at(folder.path().join("not/there/yet"));
        assert!(kept.find(&running(&image(1))).is_none());
        let path = kept.keep(&image(1)).unwrap();
        kept.keep(&image(2)).unwrap();
        assert!(path.ends_with(format!("{}.elf", "01".repeat(20))));
        assert_eq!(
            kept.find(&running(&image(1))).unwrap().build_id,
            BuildId([1; 20])
        );
        assert!(kept.find(&running(&image(3))).is_none());
        let by_crc = Running {
            crc: Some(image(2).crc),
            ..Running::default()
        };
        assert_eq!(kept.find(&by_crc).unwrap().build_id, BuildId([2; 20]));
        assert!(kept.find(&Running::default()).is_none());
    }

    #[test]
    fn a_file_that_is_not_what_its_name_says_is_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let kept = Kept::at(folder.path());
        let path = kept.keep(&image(1)).unwrap();
        fs::write(
            &path,
            SampleImage {
                build_id: 9,
                ..SampleImage::default()
            }
            .elf(),
        )
        .unwrap();
        assert!(kept.find(&running(&image(1))).is_none());
        fs::write(&path, b"cut").unwrap();
        assert!(kept.find(&running(&image(1))).is_none());
    }

    #[test]
    fn the_oldest_go_and_what_is_not_ours_stays() {
        let folder = tempfile::tempdir().unwrap();
        let kept = Kept::at(folder.path());
        let other = folder.path().join("notes.elf");
        fs::write(&other, b"mine").unwrap();
        let first = kept.keep(&image(200)).unwrap();
        let long_ago = std::time::SystemTime::UNIX_EPOCH;
        let file = fs::File::options().write(true).open(&first).unwrap();
        file.set_modified(long_ago).unwrap();
        for k in 0..MOST as u8 {
            assert!(kept.keep(&image(k)).unwrap().exists());
        }
        assert_eq!(kept.list().len(), MOST);
        assert!(!first.exists() && other.exists());
        // Kept once more, it is no further file.
        kept.keep(&image(5)).unwrap();
        assert_eq!(kept.list().len(), MOST);
    }

    #[test]
    #[cfg(all(unix, not(target_os = "macos")))]
    fn the_folder_is_where_the_system_wants_it() {
        let of = |set: &'static [(&str, &str)]| {
            data_folder(|name| set.iter().find(|(n, _)| *n == name).map(|(_, v)| v.into()))
        };
        assert_eq!(of(&[("HOME", "/h")]), Some("/h/.local/share".into()));
        assert_eq!(
            of(&[("HOME", "/h"), ("XDG_DATA_HOME", "/d")]),
            Some("/d".into())
        );
        assert_eq!(of(&[]), None);
    }
}
