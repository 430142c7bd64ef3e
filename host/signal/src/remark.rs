//! What is to be said of a capture, a sensor or an estimate beside its numbers: a code for programs, words for people,
//! the number behind it and its limit.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How much it matters to R and L.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Worth knowing; costs nothing.
    Info,
    /// R and L lose accuracy, or a part of the capture is lost.
    Warning,
    /// R and L are wrong.
    Error,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        })
    }
}

/// One remark.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remark {
    /// What it is, in `snake_case`: a name that stays.
    pub code: &'static str,
    /// How much it matters.
    pub severity: Severity,
    /// In words: what was found, and what to do.
    pub text: String,
    /// The number that was judged, in the unit that the text names; `None` where there is no single one.
    pub value: Option<f64>,
    /// What it was judged against, in the same unit; `None` where nothing was.
    pub limit: Option<f64>,
}

impl Remark {
    /// A remark without a number.
    pub fn new(code: &'static str, severity: Severity, text: impl Into<String>) -> Self {
        Self {
            code,
            severity,
            text: text.into(),
            value: None,
            limit: None,
        }
    }

    /// The same with the number that was judged and its limit; numbers that are not finite are left out.
    #[must_use]
    pub fn with(mut self, value: f64, limit: Option<f64>) -> Self {
        self.value = Some(value).filter(|x| x.is_finite());
        self.limit = limit.filter(|x| x.is_finite());
        self
    }
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.severity, self.text)
    }
}
