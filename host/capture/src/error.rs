//! Why a file cannot be read as a capture.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use super::mcap::{Losses, McapFileError};

/// Where in a file something is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Bytes from the file's beginning.
    Byte(u64),
    /// Line of a text file, the first is 1.
    Line(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Byte(offset) => write!(f, "byte {offset}"),
            Self::Line(line) => write!(f, "line {line}"),
        }
    }
}

/// What a reader of one format found wrong; [`CaptureError::Damaged`] adds the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {what}")]
pub struct FormatError {
    /// Where.
    pub place: Place,
    /// What, and what to do about it.
    pub what: String,
}

impl FormatError {
    /// Something wrong at a byte offset.
    pub fn at_byte(offset: u64, what: impl Into<String>) -> Self {
        Self {
            place: Place::Byte(offset),
            what: what.into(),
        }
    }

    /// Something wrong in a line, the first is 1.
    pub fn at_line(line: u64, what: impl Into<String>) -> Self {
        Self {
            place: Place::Line(line),
            what: what.into(),
        }
    }

    /// A read that failed at a byte offset; an unexpected end is reported as a truncated file.
    pub fn io(offset: u64, source: &io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::UnexpectedEof => Self::at_byte(offset, "the file ends here, truncated"),
            _ => Self::at_byte(offset, source.to_string()),
        }
    }

    /// The same for the file at `path`.
    pub fn in_file(self, path: &Path) -> CaptureError {
        CaptureError::Damaged {
            path: path.to_owned(),
            source: self,
        }
    }
}

/// Why a capture could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system reports.
        source: io::Error,
    },
    /// A directory, a pipe or a device.
    #[error("{} is {kind}, not a file; a capture must be a file that can be read twice", path.display())]
    NotAFile {
        /// What was named.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
    },
    /// No byte.
    #[error("{} is empty: nothing was written to it", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// No sample.
    #[error(
        "{} holds no samples{}{losses}; a recording of a device has them from its first window on",
        path.display(),
        if losses.is_none() { "" } else { ": " }
    )]
    NoSamples {
        /// The file.
        path: PathBuf,
        /// What of it could not be read.
        losses: Losses,
    },
    /// The content is in no format that is known.
    #[error("{} is no capture in a format known to ihd: {what}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// What it looks like, and what can be read.
        what: String,
    },
    /// The format is known, the content is damaged or hostile.
    #[error("{}, {source}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: FormatError,
    },
    /// The file is sound, but needs a word from the user: which channel, which unit, which rate.
    #[error("{}: {what}", path.display())]
    Choice {
        /// The file.
        path: PathBuf,
        /// What is open, and which flag settles it.
        what: String,
    },
    /// Two files that do not fit together.
    #[error("{} and {} cannot be paired: {what}", first.display(), second.display())]
    Pair {
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// What does not fit.
        what: String,
    },
    /// A capture file of ihd that cannot be read.
    #[error(transparent)]
    Mcap(#[from] McapFileError),
}
