//! Problem of Levenberg-Marquardt: residuals with their Jacobian, and the prior.

use nalgebra::DVector;

use crate::derivatives::Derivatives;

/// Sum of squares to minimise.
pub(crate) trait LeastSquares {
    /// Error of an evaluation.
    type Error;

    /// Residuals and outputs at these parameters; values that are not finite only shorten the step.
    fn evaluate(&self, theta: &[f64]) -> Result<Evaluation, Self::Error>;

    /// ∂e/∂θ at these parameters, one row per residual.
    fn jacobian(&self, theta: &[f64]) -> Result<Derivatives, Self::Error>;
}

/// Residuals and outputs at one set of parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Evaluation {
    /// e.
    pub residuals: Vec<f64>,
    /// Outputs that must converge: R, L alternating, in units of their scales.
    pub outputs: Vec<f64>,
}

impl Evaluation {
    /// |e|².
    pub fn squares(&self) -> f64 {
        self.residuals.iter().map(|e| e * e).sum()
    }
}

/// Normal prior of the parameters.
///
/// With a strength of (variance of a residual) / (variance of a parameter) the minimum is the most probable
/// set of parameters for normal noise and normal parameters. Without noise the strength is zero and the
/// residuals alone decide. With noise it keeps R and L from following the noise where the current is small.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Prior {
    /// s.
    pub strength: f64,
    /// c, as long as θ.
    pub centre: Vec<f64>,
}

impl Prior {
    /// θ − c.
    pub(super) fn distance(&self, theta: &[f64]) -> DVector<f64> {
        let differences = theta.iter().zip(&self.centre).map(|(x, c)| x - c);
        DVector::from_iterator(theta.len(), differences)
    }
}
