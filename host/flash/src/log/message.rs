//! Decoded message.

use std::fmt;

use serde::{Serialize, Serializer};

/// Severity of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LogLevel {
    /// Every step.
    Trace,
    /// Information for debugging.
    Debug,
    /// Normal event.
    Info,
    /// Unexpected event that the firmware handles.
    Warn,
    /// Error that a user should know of.
    Error,
}

impl LogLevel {
    /// All levels, the lowest first.
    pub const ALL: [Self; 5] = [
        Self::Trace,
        Self::Debug,
        Self::Info,
        Self::Warn,
        Self::Error,
    ];

    /// Name of the level: `info`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

impl From<defmt_parser::Level> for LogLevel {
    fn from(level: defmt_parser::Level) -> Self {
        use defmt_parser::Level as Of;
        match level {
            Of::Trace => Self::Trace,
            Of::Debug => Self::Debug,
            Of::Info => Self::Info,
            Of::Warn => Self::Warn,
            Of::Error => Self::Error,
        }
    }
}

/// Place of a message in the firmware's source.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SourceLocation {
    /// Module: `ihd_firmware::board::start`.
    pub module: String,
    /// File, relative to the checkout's root or with its crate.
    pub file: String,
    /// Line, from 1.
    pub line: u64,
}

impl fmt::Display for SourceLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)
    }
}

impl Serialize for SourceLocation {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

/// Message of a board. Its texts are printable: control characters are escaped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogMessage {
    /// Severity; `None` if the firmware prints without a level.
    pub level: Option<LogLevel>,
    /// Text.
    pub text: String,
    /// Time of the board; `None` if it sends none.
    pub uptime: Option<String>,
    /// Place in the source; `None` if the image has no debug information.
    pub place: Option<SourceLocation>,
}
