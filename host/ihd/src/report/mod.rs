//! What a person reads or looks at after a command: tables and figures.

pub mod identified;
pub mod plot;
pub mod recording;
pub mod scenario;
pub mod survey;
pub mod table;
#[cfg(feature = "pinn")]
pub mod trained;
#[cfg(feature = "pinn")]
pub mod training;
pub mod utilisation;

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// The recording has too few samples or no current.
    #[error("nothing to draw: the recording has no period with current")]
    Empty,
    /// Drawing or writing failed.
    #[error("cannot draw {path}: {why}")]
    Draw {
        /// Which file.
        path: String,
        /// What the backend or the operating system reports.
        why: String,
    },
}

impl FigureError {
    /// Names the file that was to be drawn.
    pub fn new(path: &std::path::Path, why: &dyn std::fmt::Display) -> Self {
        Self::Draw {
            path: path.display().to_string(),
            why: why.to_string(),
        }
    }
}
