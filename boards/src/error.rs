//! Errors of a board file.

use std::path::PathBuf;

/// Error of a board file; each names the file and, where it has one, the line.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The file cannot be read.
    #[error("cannot read the board file {path}: {source}", path = .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    /// The file is no TOML.
    #[error("{path}: {why}", path = .path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Reason, with its place.
        why: String,
    },
    /// A value is missing.
    #[error("{path}: {name} is missing: {purpose}", path = .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// Section and key.
        name: String,
        /// Purpose of the value.
        purpose: &'static str,
    },
    /// A value that cannot be used.
    #[error("{path}:{line}: {name}: {why}", path = .path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Line of the value.
        line: usize,
        /// Section and key.
        name: String,
        /// Defect, and the values that are allowed.
        why: String,
    },
}
