//! Signals of the VI branch.

/// Outputs of a VI branch at some of the window's samples, normalised.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Signals {
    /// Indices of the samples, ascending.
    pub sample: Vec<usize>,
    pub v: Vec<f64>,
    pub i: Vec<f64>,
}
