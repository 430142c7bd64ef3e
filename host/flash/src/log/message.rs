//! A decoded message.

use std::fmt;

use serde::{Serialize, Serializer};

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Every step.
    Trace,
    /// For whoever looks for a defect.
    Debug,
    /// What happens.
    Info,
    /// What should not happen, and is dealt with.
    Warn,
    /// What a person should know.
    Error,
}

impl Level {
    /// All, the least first.
    pub const ALL: [Self; 5] = [
        Self::Trace,
        Self::Debug,
        Self::Info,
        Self::Warn,
        Self::Error,
    ];

    /// In one word: `info`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

impl From<defmt_parser::Level> for Level {
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

/// Where in the firmware's text a message stands.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Place {
    /// The module: `ihd_firmware::board::start`.
    pub module: String,
    /// The file, from the checkout's root or with its crate.
    pub file: String,
    /// The line, from 1.
    pub line: u64,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)
    }
}

impl Serialize for Place {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

/// A message of a board. Its texts are fit to be shown: what a terminal would obey is escaped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// How much it matters; none where the firmware prints without a level.
    pub level: Option<Level>,
    /// What it says.
    pub text: String,
    /// The board's time, where it sends it.
    pub uptime: Option<String>,
    /// Where it stands; none where the image has no debug information.
    pub place: Option<Place>,
}
