//! The table of the image that runs on a board, wherever it is.

use std::path::Path;

use super::kept::Kept;
use super::running::Running;
use super::table::{Table, TableError};
use crate::image::{Image, ImageError, OF_CHECKOUT};

/// Why a board's log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum NoTable {
    /// The image that was given cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// It is of another image than the one that runs.
    #[error(
        "{given} is not what runs on the board: it is {image}, the board runs {running}. A log is read with its own image \
         alone: give that one, or flash this one"
    )]
    Another {
        /// The file.
        given: String,
        /// What it is.
        image: String,
        /// What runs.
        running: String,
    },
    /// The board told nothing by which its image is known.
    #[error(
        "the board does not say which image it runs (a simulated hob has none, a firmware before protocol 2.2 does not \
         tell), so its log cannot be read; frames are counted"
    )]
    Nameless,
    /// It is nowhere.
    #[error(
        "the texts of {running} are not here, so its log cannot be read; frames are counted. Looked in {}. Give its file \
         with --image: the release archive has it, a checkout of the same commit builds it (`cargo xtask firmware`), and \
         `ihd flash` keeps what it flashes",
        looked.join(", ")
    )]
    Nowhere {
        /// What runs.
        running: String,
        /// Where it was looked for.
        looked: Vec<String>,
    },
    /// It is there, and its messages cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
}

/// Where images are looked for.
#[derive(Clone, Debug, Default)]
pub struct Places<'a> {
    /// The file that was named: then nowhere else.
    pub given: Option<&'a Path>,
    /// What was flashed from here.
    pub kept: Option<Kept>,
}

impl Places<'_> {
    /// The table of what runs: of the file that was named; else of the image that this program carries, of the
    /// checkout's, or of one that was flashed from here.
    ///
    /// # Errors
    /// [`NoTable`].
    pub fn table(&self, running: &Running) -> Result<Table, NoTable> {
        if let Some(path) = self.given {
            return of_given(path, running);
        }
        if (running.build_id, running.crc) == (None, None) {
            return Err(NoTable::Nameless);
        }
        let built_in = Image::built_in();
        let mut looked = Vec::new();
        if built_in.is_some() {
            looked.push("this program".to_owned());
        }
        let of_checkout = || Image::of_checkout().and_then(Result::ok);
        looked.push(OF_CHECKOUT.to_owned());
        let of_kept = || self.kept.as_ref()?.find(running);
        if let Some(kept) = &self.kept {
            looked.push(kept.folder().display().to_string());
        }
        let is = |image: &Image| running.is(image);
        let found = built_in.and_then(Result::ok).filter(is);
        let found = found.or_else(|| of_checkout().filter(is)).or_else(of_kept);
        match found {
            Some(image) => Ok(table_of(&image)?),
            None => Err(NoTable::Nowhere {
                running: running.describe(),
                looked,
            }),
        }
    }
}

fn of_given(path: &Path, running: &Running) -> Result<Table, NoTable> {
    let image = Image::read(path)?;
    if (running.build_id, running.crc) == (None, None) {
        return Err(NoTable::Nameless);
    }
    if !running.is(&image) {
        return Err(NoTable::Another {
            given: path.display().to_string(),
            image: image.describe(),
            running: running.describe(),
        });
    }
    Ok(table_of(&image)?)
}

fn table_of(image: &Image) -> Result<Table, TableError> {
    let from = image.path.as_ref().map(|path| path.display().to_string());
    Table::parse(image.elf(), from.as_deref().unwrap_or("the built-in image"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fake::SampleImage;
    use crate::image::BuildId;

    fn running(id: u8) -> Running {
        Running {
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
            kept: None,
        };
        let why = places.table(&running(7)).err().unwrap();
        assert!(matches!(why, NoTable::Another { .. }), "{why}");
        let text = why.to_string();
        assert!(
            text.contains("b1b1b1b1") && text.contains("07070707"),
            "{text}"
        );
        // The right one, but it logs nothing.
        let why = places.table(&running(0xB1)).err().unwrap();
        assert!(
            matches!(why, NoTable::Table(TableError::None { .. })),
            "{why}"
        );
        let why = places.table(&Running::default()).err().unwrap();
        assert!(matches!(why, NoTable::Nameless), "{why}");
    }

    #[test]
    fn what_is_nowhere_says_where_it_was_looked_for_and_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places {
            given: None,
            kept: Some(Kept::at(folder.path())),
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
