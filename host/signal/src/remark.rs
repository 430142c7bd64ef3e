//! Remarks on a capture, a sensor or an estimate: a code for programs, a text for people, a value and its limit.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Effect of a remark on R and L.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// No effect.
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

/// Remark on a capture, a sensor or an estimate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Remark {
    /// Code in `snake_case`, which never changes.
    pub code: &'static str,
    /// Effect on R and L.
    pub severity: Severity,
    /// Text that says what was found and what to do.
    pub text: String,
    /// Value that was judged, in the unit that the text names; `None` if there is no single one.
    pub value: Option<f64>,
    /// Limit of the value, in the same unit; `None` if there is none.
    pub limit: Option<f64>,
}

impl Remark {
    /// Creates a remark without a value.
    pub fn new(code: &'static str, severity: Severity, text: impl Into<String>) -> Self {
        Self {
            code,
            severity,
            text: text.into(),
            value: None,
            limit: None,
        }
    }

    /// Adds the value that was judged, and its limit; numbers that are not finite are left out.
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
