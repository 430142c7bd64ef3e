//! What a person reads or looks at after a command: tables and figures.

#[cfg(feature = "pinn")]
pub mod figure;
pub mod identified;
pub mod table;
#[cfg(feature = "pinn")]
pub mod training;

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw {path}: {why}")]
pub struct FigureError {
    path: String,
    why: String,
}

impl FigureError {
    /// Names the file that was to be drawn.
    pub fn new(path: &std::path::Path, why: &dyn std::fmt::Display) -> Self {
        Self {
            path: path.display().to_string(),
            why: why.to_string(),
        }
    }
}
