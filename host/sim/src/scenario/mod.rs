//! Scenarios: runs of the firmware lib in simulated time by a file of events, with a record of the results.
//!
//! ```text
//! FILE.toml ─► variants ─► file ─► timeline ─► run ─► record, summary ─► limits, JSON
//!                                               │▲
//!                                   host ◄─► SimHob (plant, firmware)
//! ```

pub mod fault_log;
pub mod file;
pub mod host;
pub mod limits;
mod measured;
mod number;
pub mod record;
pub mod run;
pub mod script;
pub mod summary;
pub mod surroundings;
#[cfg(test)]
mod tests;
pub mod timeline;
pub mod variants;

use std::path::PathBuf;

use crate::inverter::InverterError;

/// Error of a scenario.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is no TOML, or has an invalid field or value; names line, field and allowed values.
    #[error(transparent)]
    Syntax(Box<toml::de::Error>),
    /// An event is invalid.
    #[error("event {number} (line {line}): {why}")]
    Event {
        /// Number of the event, from 1.
        number: usize,
        /// Line of the file on which the event begins.
        line: usize,
        /// Defect and allowed values.
        why: String,
    },
    /// A `[[matrix]]` cannot be inserted into its file.
    #[error("matrix {path}: {why}")]
    Matrix {
        /// Path of names and numbers, separated by dots.
        path: String,
        /// Place at which it ends, and what is there.
        why: String,
    },
    /// A setting in the file's head is invalid.
    #[error(transparent)]
    Plant(#[from] InverterError),
}
