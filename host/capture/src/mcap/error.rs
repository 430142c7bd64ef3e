//! Why a capture file cannot be written or read.

use std::io;
use std::path::PathBuf;

use ihd_shared::wire::hello::Mismatch;

use super::topics::PROFILE;

/// Why a capture file cannot be written or read; names the file and, where there is one, the place.
#[derive(Debug, thiserror::Error)]
pub enum McapFileError {
    /// The operating system refused.
    #[error("{} at byte {offset}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// How far it was read or written.
        offset: u64,
        /// What the operating system reports.
        source: io::Error,
    },
    /// The file exists already.
    #[error("{} exists already; a recording is never overwritten", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A directory, a pipe or a device.
    #[error("{} is {what}; a capture must be a regular file", path.display())]
    NotAFile {
        /// What was named.
        path: PathBuf,
        /// What it is.
        what: &'static str,
    },
    /// The file does not begin as an MCAP file does.
    #[error("{} is no MCAP file: it begins with other bytes", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// An MCAP file of something else, or of a later ihd.
    #[error(
        "{} is an MCAP file of profile {found:?}; this ihd reads {PROFILE:?}{hint}",
        path.display()
    )]
    Profile {
        /// The file.
        path: PathBuf,
        /// Its profile.
        found: String,
        /// What to do about it; begins with "; " or is empty.
        hint: &'static str,
    },
    /// A declared size that no capture has.
    #[error(
        "{} at byte {offset}: {what} declares {declared} bytes, more than the {limit} allowed",
        path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        offset: u64,
        /// What declares the size.
        what: &'static str,
        /// The declared size.
        declared: u64,
        /// The largest size allowed.
        limit: u64,
    },
    /// More pairs than a capture in memory may have.
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
    /// A record that does not hold what it should.
    #[error("{} at byte {offset}: {what}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the record, or the chunk that holds it, begins.
        offset: u64,
        /// What is wrong with it.
        what: String,
    },
    /// The file does not hold what was asked of it.
    #[error("{} {what}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What it lacks, as the end of a sentence.
        what: &'static str,
    },
    /// The session was recorded from a device that this host does not understand.
    #[error("{} was recorded from a device that does not fit this host: {why}", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What differs.
        why: Mismatch,
    },
    /// Writing failed.
    #[error("cannot write {}: {}", path.display(), cause(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: ::mcap::McapError,
    },
}

/// What the operating system reports, where it is that: the crate's own words leave it out.
fn cause(source: &::mcap::McapError) -> String {
    match source {
        ::mcap::McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

impl McapFileError {
    /// Whether a part of the file is damaged, behind which it may be read on.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::TooLong { .. })
    }
}
