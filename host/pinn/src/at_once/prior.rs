//! Normal processes over the law's axis, as normal coefficients of its splines.

use ihd_spline::CubicSpline;
use nalgebra::{Cholesky, DMatrix};

/// Least independent part of a coefficient relative to the width: the covariance of smooth functions is singular to working
/// precision without.
const NUGGET: f64 = 1e-7;

/// Normal process with the covariance width² e^(−d²/2length²) + level² between places d apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Process {
    pub width: f64,
    pub length: f64,
    pub level: f64,
}

/// Inverse of the coefficients' covariance and the logarithm of its determinant; `None` if rounding leaves none.
pub(super) fn precision(
    spline: &CubicSpline,
    reach: f64,
    process: &Process,
) -> Option<(DMatrix<f64>, f64)> {
    let size = spline.functions();
    let intervals = size - 3;
    // Each function's middle: the mean of its three inner knots.
    let knot = |k: usize| k.saturating_sub(3).min(intervals) as f64;
    let middle =
        |k: usize| (knot(k + 1) + knot(k + 2) + knot(k + 3)) / 3.0 * reach / intervals as f64;
    let variance = process.width.powi(2);
    let covariance = DMatrix::from_fn(size, size, |a, b| {
        let far = (middle(a) - middle(b)) / process.length;
        let own = if a == b { NUGGET } else { 0.0 };
        variance * ((-0.5 * far * far).exp() + own) + process.level.powi(2)
    });
    let factor = Cholesky::new(covariance)?;
    let half: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
    Some((factor.inverse(), -2.0 * half))
}
