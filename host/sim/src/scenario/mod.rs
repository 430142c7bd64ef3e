//! Scenarios: the firmware lib in simulated time against a file of events, and what came of it.
//!
//! ```text
//! FILE.toml ─► variants ─► file ─► timeline ─► run ─► record, summary ─► limits, JSON
//!                                               │▲
//!                                   host ◄─► SimHob (plant, firmware)
//! ```

pub mod file;
mod host;
pub mod limits;
mod measured;
mod number;
pub mod record;
pub mod run;
pub mod script;
mod summary;
mod surroundings;
#[cfg(test)]
mod tests;
pub mod timeline;
pub mod variants;

use std::path::PathBuf;

use crate::inverter::InverterError;

/// Why a scenario cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// Which one.
        path: PathBuf,
        /// What the operating system reports.
        source: std::io::Error,
    },
    /// The file is not TOML, or has a field or value that no scenario has; names line, field and what is
    /// allowed.
    #[error(transparent)]
    Syntax(Box<toml::de::Error>),
    /// An event asks for what cannot be.
    #[error("event {number} (line {line}): {why}")]
    Event {
        /// Counted from 1.
        number: usize,
        /// Line of the file on which the event begins.
        line: usize,
        /// What is wrong and what is allowed.
        why: String,
    },
    /// A `[[matrix]]` that cannot be put into its file.
    #[error("matrix {path}: {why}")]
    Matrix {
        /// Path of names and numbers, separated by dots.
        path: String,
        /// Place at which it ends, and what is there.
        why: String,
    },
    /// A setting of the file's head that cannot be.
    #[error(transparent)]
    Plant(#[from] InverterError),
}
