//! Error of drawing a figure.

/// Error of drawing a figure.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// The recording has too few samples or no current.
    #[error("nothing to draw: the recording has no period with current")]
    Empty,
    /// Drawing or writing failed.
    #[error("cannot draw {path}: {why}")]
    Draw {
        /// Path of the file.
        path: String,
        /// Error of the backend or the operating system.
        why: String,
    },
}

impl FigureError {
    /// Adds the name of the file.
    pub fn new(path: &std::path::Path, why: &dyn std::fmt::Display) -> Self {
        Self::Draw {
            path: path.display().to_string(),
            why: why.to_string(),
        }
    }
}
