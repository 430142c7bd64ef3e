//! Errors of reading a file as a capture.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use super::mcap::{FileLosses, McapFileError};

/// Place of an error in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Byte offset.
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

/// Error of a format's reader; [`CaptureError::Damaged`] adds the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {what}")]
pub struct FormatError {
    /// Place of the error.
    pub place: Place,
    /// Description and advice.
    pub what: String,
}

impl FormatError {
    /// Creates an error at a byte offset.
    pub fn at_byte(offset: u64, what: impl Into<String>) -> Self {
        Self {
            place: Place::Byte(offset),
            what: what.into(),
        }
    }

    /// Creates an error in a line; the first line is 1.
    pub fn at_line(line: u64, what: impl Into<String>) -> Self {
        Self {
            place: Place::Line(line),
            what: what.into(),
        }
    }

    /// Converts an I/O error at a byte offset; an unexpected end is reported as a truncated file.
    pub fn io(offset: u64, source: &io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::UnexpectedEof => Self::at_byte(offset, "the file ends here, truncated"),
            _ => Self::at_byte(offset, source.to_string()),
        }
    }

    /// Adds the path of the file.
    pub fn in_file(self, path: &Path) -> CaptureError {
        CaptureError::Damaged {
            path: path.to_owned(),
            source: self,
        }
    }
}

/// Error of opening a capture.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The operating system denied access.
    #[error("{}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The path is a directory, a pipe or a device.
    #[error("{} is {kind}, not a file; a capture must be a file that can be read twice", path.display())]
    NotAFile {
        /// Path given.
        path: PathBuf,
        /// Kind of the path.
        kind: &'static str,
    },
    /// The file is empty.
    #[error("{} is empty: nothing was written to it", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file holds no samples.
    #[error(
        "{} holds no samples{}{losses}; a recording of a device has them from its first window on",
        path.display(),
        if losses.is_none() { "" } else { ": " }
    )]
    NoSamples {
        /// The file.
        path: PathBuf,
        /// Parts that could not be read.
        losses: FileLosses,
    },
    /// The format is unknown.
    #[error("{} is no capture in a format known to ihd: {what}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Description of the content, and the list of readable formats.
        what: String,
    },
    /// The format is known, the content is damaged or hostile.
    #[error("{}, {source}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Place and description.
        source: FormatError,
    },
    /// A choice of the user is required: channel, unit or rate.
    #[error("{}: {what}", path.display())]
    Choice {
        /// The file.
        path: PathBuf,
        /// Description of the choice, and the flag that makes it.
        what: String,
    },
    /// Two files do not fit together.
    #[error("{} and {} cannot be paired: {what}", first.display(), second.display())]
    Pair {
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// Difference between them.
        what: String,
    },
    /// Error of a capture file of ihd.
    #[error(transparent)]
    Mcap(#[from] McapFileError),
}
