//! Cache of the images flashed from this machine, by build id: decoding a board's log needs their texts.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use ihd_signal::atomic;

use super::running::RunningProgram;
use crate::image::{BuildId, Image};

/// Limit of cached images; the oldest are removed.
pub const MAX_IMAGES: usize = 24;

/// Folder of images.
#[derive(Clone, Debug)]
pub struct ImageCache {
    folder: PathBuf,
}

impl ImageCache {
    /// Cache of the user: `ihd/images` in the folder for program data. `None` if the user has no such folder.
    pub fn of_user() -> Option<Self> {
        let folder = data_folder(|name| {
            let value = std::env::var_os(name).map(PathBuf::from)?;
            // By the XDG specification a relative path is ignored.
            value.is_absolute().then_some(value)
        })?;
        Some(Self::at(folder.join("ihd").join("images")))
    }

    /// Cache in a folder, which need not exist yet.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Stores an image, completely or not at all, and removes the oldest.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn keep(&self, image: &Image) -> io::Result<PathBuf> {
        fs::create_dir_all(&self.folder)?;
        let path = self.path(&image.build_id);
        atomic::write(&path, image.elf())?;
        let mut cache = self.list();
        cache.sort_by_key(|path| fs::metadata(path).and_then(|file| file.modified()).ok());
        let too_many = cache.len().saturating_sub(MAX_IMAGES);
        // A failed removal is repeated the next time.
        for old in cache.iter().filter(|old| **old != path).take(too_many) {
            let _ = fs::remove_file(old);
        }
        Ok(path)
    }

    /// Returns the running image if the cache has an undamaged copy.
    pub fn find(&self, running: &RunningProgram) -> Option<Image> {
        let named = running.build_id.map(|id| self.path(&id));
        // Without a build id, any of them may match.
        let paths = named.map_or_else(|| self.list(), |path| vec![path]);
        paths
            .iter()
            .filter_map(|path| Image::read(path).ok())
            .find(|image| running.is(image))
    }

    fn path(&self, id: &BuildId) -> PathBuf {
        self.folder.join(format!("{id}.elf"))
    }

    /// Lists the files with names of cached images; other files are ignored.
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

/// Folder for the user's program data, from the operating system's variables.
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
    use ihd_fakes::SampleImage;

    fn image(build_id: u8) -> Image {
        let sample = SampleImage {
            build_id,
            ..SampleImage::default()
        };
        Image::parse(&sample.elf(), None).unwrap()
    }

    fn running(image: &Image) -> RunningProgram {
        RunningProgram {
            build_id: Some(image.build_id),
            ..RunningProgram::default()
        }
    }

    #[test]
    fn what_was_flashed_is_found_again_by_build_id_and_by_crc() {
        let folder = tempfile::tempdir().unwrap();
        let cache = ImageCache::at(folder.path().join("not/there/yet"));
        assert!(cache.find(&running(&image(1))).is_none());
        let path = cache.keep(&image(1)).unwrap();
        cache.keep(&image(2)).unwrap();
        assert!(path.ends_with(format!("{}.elf", "01".repeat(20))));
        assert_eq!(
            cache.find(&running(&image(1))).unwrap().build_id,
            BuildId([1; 20])
        );
        assert!(cache.find(&running(&image(3))).is_none());
        let by_crc = RunningProgram {
            crc: Some(image(2).crc),
            ..RunningProgram::default()
        };
        assert_eq!(cache.find(&by_crc).unwrap().build_id, BuildId([2; 20]));
        assert!(cache.find(&RunningProgram::default()).is_none());
    }

    #[test]
    fn a_file_that_is_not_what_its_name_says_is_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let cache = ImageCache::at(folder.path());
        let path = cache.keep(&image(1)).unwrap();
        fs::write(
            &path,
            SampleImage {
                build_id: 9,
                ..SampleImage::default()
            }
            .elf(),
        )
        .unwrap();
        assert!(cache.find(&running(&image(1))).is_none());
        fs::write(&path, b"cut").unwrap();
        assert!(cache.find(&running(&image(1))).is_none());
    }

    #[test]
    fn the_oldest_go_and_what_is_not_ours_stays() {
        let folder = tempfile::tempdir().unwrap();
        let cache = ImageCache::at(folder.path());
        let other = folder.path().join("notes.elf");
        fs::write(&other, b"mine").unwrap();
        let first = cache.keep(&image(200)).unwrap();
        let long_ago = std::time::SystemTime::UNIX_EPOCH;
        let file = fs::File::options().write(true).open(&first).unwrap();
        file.set_modified(long_ago).unwrap();
        for k in 0..MAX_IMAGES as u8 {
            assert!(cache.keep(&image(k)).unwrap().exists());
        }
        assert_eq!(cache.list().len(), MAX_IMAGES);
        assert!(!first.exists() && other.exists());
        // Kept once more, it is no further file.
        cache.keep(&image(5)).unwrap();
        assert_eq!(cache.list().len(), MAX_IMAGES);
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
