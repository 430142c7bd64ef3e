//! Wrong usage that clap does not detect: values out of range, unknown names.

/// Error of the arguments; `ihd` exits with 2.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

impl Usage {
    /// Wraps any error whose message names the argument.
    pub fn from_error(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// Returns [`Usage`] with a message unless the condition holds.
#[macro_export]
macro_rules! ensure_usage {
    ($condition:expr, $($message:tt)+) => {
        if !$condition {
            return Err($crate::cli::usage::Usage(format!($($message)+)).into());
        }
    };
}
