//! Errors of writing and reading a capture file.

use std::io;
use std::path::PathBuf;

use ihd_shared::wire::hello::Mismatch;

use super::topics::PROFILE;

/// Error of writing or reading a capture file, with the file and, if known, the place.
#[derive(Debug, thiserror::Error)]
pub enum McapFileError {
    /// The operating system reported an error.
    #[error("{} at byte {offset}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Offset up to which it was read or written.
        offset: u64,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file already exists.
    #[error("{} exists already; a recording is never overwritten", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The path is a directory, a pipe or a device.
    #[error("{} is {what}; a capture must be a regular file", path.display())]
    NotAFile {
        /// Path given.
        path: PathBuf,
        /// Kind of the path.
        what: &'static str,
    },
    /// The file does not begin like an MCAP file.
    #[error("{} is no MCAP file: it begins with other bytes", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The MCAP file has another profile, or comes from a newer ihd.
    #[error(
        "{} is an MCAP file of profile {profile:?}; this ihd reads {PROFILE:?}{hint}",
        path.display()
    )]
    Profile {
        /// The file.
        path: PathBuf,
        /// Profile of the file.
        profile: String,
        /// Advice; begins with "; " or is empty.
        hint: &'static str,
    },
    /// A declared size exceeds the limit.
    #[error(
        "{} at byte {offset}: {what} declares {declared} bytes, more than the {limit} allowed",
        path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Offset of the record.
        offset: u64,
        /// Field that declares the size.
        what: &'static str,
        /// The declared size.
        declared: u64,
        /// The largest size allowed.
        limit: u64,
    },
    /// The file has more pairs than a capture in memory may hold.
    #[error(
        "{} holds more than {limit} pairs of samples; cut it first, for instance with `mcap filter`",
        path.display()
    )]
    TooManyPairs {
        /// The file.
        path: PathBuf,
        /// The largest number allowed.
        limit: usize,
    },
    /// A record is damaged.
    #[error("{} at byte {offset}: {what}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Offset of the record, or of its chunk.
        offset: u64,
        /// Description of the damage.
        what: String,
    },
    /// The file lacks the requested data.
    #[error("{} {what}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// Missing data, as the end of a sentence.
        what: &'static str,
    },
    /// The session comes from a device of an incompatible protocol.
    #[error("{} was recorded from a device that does not fit this host: {why}", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// Difference of the protocols.
        why: Mismatch,
    },
    /// Writing failed.
    #[error("cannot write {}: {}", path.display(), cause(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// Error of the writer.
        source: ::mcap::McapError,
    },
}

/// Error of the operating system, if that is the cause: the crate's own message omits it.
fn cause(source: &::mcap::McapError) -> String {
    match source {
        ::mcap::McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

impl McapFileError {
    /// Returns `true` for a damaged part of the file, after which reading can continue.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::TooLong { .. })
    }
}
