//! Search for the table of the image that runs on a board.

use std::path::Path;

use super::image_cache::ImageCache;
use super::running::RunningProgram;
use super::table::{LogTable, LogTableError};
use crate::image::{Image, ImageError, OF_CHECKOUT};

/// Error of finding a board's table.
#[derive(Debug, thiserror::Error)]
pub enum TableLookupError {
    /// The given image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The given image is not the one that runs.
    #[error(
        "{given} is not what runs on the board: it is {image}, the board runs {running}. A log is read with its own image \
         alone: give that one, or flash this one"
    )]
    Another {
        /// The file.
        given: String,
        /// Description of the given image.
        image: String,
        /// Description of the running program.
        running: String,
    },
    /// The board reported nothing that identifies its image.
    #[error(
        "the board does not say which image it runs (a simulated hob has none, a firmware before protocol 2.2 does not \
         tell), so its log cannot be read; frames are counted"
    )]
    Nameless,
    /// No copy of the image is available.
    #[error(
        "the texts of {running} are not here, so its log cannot be read; frames are counted. Looked in {}. Give its file \
         with --image: the release archive has it, a checkout of the same commit builds it (`cargo xtask firmware`), and \
         `ihd flash` keeps what it flashes",
        looked.join(", ")
    )]
    Nowhere {
        /// Description of the running program.
        running: String,
        /// Places searched.
        looked: Vec<String>,
    },
    /// The image was found, but its messages cannot be read.
    #[error(transparent)]
    Table(#[from] LogTableError),
}

/// Places to search for images.
#[derive(Clone, Debug, Default)]
pub struct Places<'a> {
    /// File given by the user; if set, no other place is searched.
    pub given: Option<&'a Path>,
    /// Cache of the images flashed from this machine.
    pub cache: Option<ImageCache>,
}

impl Places<'_> {
    /// Returns the table of the running program: from the given file; else from the built-in image, the checkout's, or the cache.
    ///
    /// # Errors
    /// [`TableLookupError`].
    pub fn table(&self, running: &RunningProgram) -> Result<LogTable, TableLookupError> {
        if let Some(path) = self.given {
            return of_given(path, running);
        }
        if (running.build_id, running.crc) == (None, None) {
            return Err(TableLookupError::Nameless);
        }
        let built_in = Image::built_in();
        let mut looked = Vec::new();
        if built_in.is_some() {
            looked.push("this program".to_owned());
        }
        let of_checkout = || Image::of_checkout().and_then(Result::ok);
        looked.push(OF_CHECKOUT.to_owned());
        let of_cache = || self.cache.as_ref()?.find(running);
        if let Some(cache) = &self.cache {
            looked.push(cache.folder().display().to_string());
        }
        let is = |image: &Image| running.is(image);
        let image = built_in.and_then(Result::ok).filter(is);
        let image = image.or_else(|| of_checkout().filter(is)).or_else(of_cache);
        match image {
            Some(image) => Ok(table_of(&image)?),
            None => Err(TableLookupError::Nowhere {
                running: running.describe(),
                looked,
            }),
        }
    }
}

fn of_given(path: &Path, running: &RunningProgram) -> Result<LogTable, TableLookupError> {
    let image = Image::read(path)?;
    if (running.build_id, running.crc) == (None, None) {
        return Err(TableLookupError::Nameless);
    }
    if !running.is(&image) {
        return Err(TableLookupError::Another {
            given: path.display().to_string(),
            image: image.describe(),
            running: running.describe(),
        });
    }
    Ok(table_of(&image)?)
}

fn table_of(image: &Image) -> Result<LogTable, LogTableError> {
    let from = image.path.as_ref().map(|path| path.display().to_string());
    LogTable::parse(image.elf(), from.as_deref().unwrap_or("the built-in image"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::BuildId;
    use ihd_fakes::SampleImage;

    fn running(id: u8) -> RunningProgram {
        RunningProgram {
            build: "ihd-firmware 9.8.7".into(),
            build_id: Some(BuildId([id; 20])),
            crc: None,
        }
    }

    #[test]
    fn an_image_that_does_not_run_is_refused_by_its_build_id() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.elf");
        std::fs::write(&path, SampleImage::default().elf()).unwrap();
        let places = Places {
            given: Some(&path),
            cache: None,
        };
        let why = places.table(&running(7)).err().unwrap();
        assert!(matches!(why, TableLookupError::Another { .. }), "{why}");
        let text = why.to_string();
        assert!(
            text.contains("b1b1b1b1") && text.contains("07070707"),
            "{text}"
        );
        // The right one, but it logs nothing.
        let why = places.table(&running(0xB1)).err().unwrap();
        assert!(
            matches!(why, TableLookupError::Table(LogTableError::None { .. })),
            "{why}"
        );
        let why = places.table(&RunningProgram::default()).err().unwrap();
        assert!(matches!(why, TableLookupError::Nameless), "{why}");
    }

    #[test]
    fn what_is_nowhere_says_where_it_was_looked_for_and_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places {
            given: None,
            cache: Some(ImageCache::at(folder.path())),
        };
        let why = places.table(&running(7)).err().unwrap().to_string();
        for word in [
            "07070707",
            "--image",
            folder.path().to_str().unwrap(),
            OF_CHECKOUT,
        ] {
            assert!(why.contains(word), "{word}: {why}");
        }
    }
}
