//! Damped least squares (Levenberg-Marquardt) with Gaussian priors and a numeric Jacobian.

use nalgebra::{SMatrix, SVector};

/// Prior of a parameter: mean and standard deviation. A thousandth of the latter is the step of its derivative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prior {
    pub mean: f64,
    pub sigma: f64,
}

/// Result of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FitResult<const N: usize> {
    pub x: [f64; N],
    /// Sum of squared residuals, including the priors.
    pub chi2: f64,
}

/// Residuals of a fit, and the priors of its parameters.
struct Problem<'a, const N: usize, F> {
    priors: &'a [Prior; N],
    residuals: F,
}

impl<const N: usize, F: FnMut(&[f64; N], &mut Vec<f64>)> Problem<'_, N, F> {
    /// Sets `out` to all residuals, those of the priors last; returns the sum of their squares, which is infinite if one is not finite.
    fn evaluate(&mut self, x: &[f64; N], out: &mut Vec<f64>) -> f64 {
        out.clear();
        (self.residuals)(x, out);
        for (x, prior) in x.iter().zip(self.priors) {
            out.push((x - prior.mean) / prior.sigma);
        }
        let sum: f64 = out.iter().map(|r| r * r).sum();
        if sum.is_finite() { sum } else { f64::INFINITY }
    }

    /// Slopes of the residuals over each parameter, by differences from those at `x`.
    fn slopes(&mut self, x: &[f64; N], here: &[f64]) -> [Vec<f64>; N] {
        let mut there = Vec::new();
        std::array::from_fn(|k| {
            let step = 1e-3 * self.priors[k].sigma;
            let mut beside = *x;
            beside[k] += step;
            self.evaluate(&beside, &mut there);
            let pairs = there.iter().zip(here);
            pairs.map(|(a, b)| (a - b) / step).collect()
        })
    }
}

/// Fits `residuals` (each over its σ, written to the buffer) from `start`, with at most `steps` steps. Points at which a
/// residual is not finite are rejected.
pub(crate) fn fit<const N: usize>(
    priors: &[Prior; N],
    start: [f64; N],
    steps: usize,
    residuals: impl FnMut(&[f64; N], &mut Vec<f64>),
) -> FitResult<N> {
    let mut problem = Problem { priors, residuals };
    let (mut here, mut there) = (Vec::new(), Vec::new());
    let mut best = FitResult {
        x: start,
        chi2: problem.evaluate(&start, &mut here),
    };
    let mut damping = 1e-3;
    for _ in 0..steps {
        let slopes = problem.slopes(&best.x, &here);
        let normal = SMatrix::<f64, N, N>::from_fn(|m, n| dot(&slopes[m], &slopes[n]));
        let right = SVector::<f64, N>::from_fn(|m, _| -dot(&slopes[m], &here));
        let before = best.chi2;
        for _ in 0..6 {
            let mut damped = normal;
            for k in 0..N {
                damped[(k, k)] *= 1.0 + damping;
            }
            let Some(change) = damped.cholesky().map(|c| c.solve(&right)) else {
                damping *= 10.0;
                continue;
            };
            let x = std::array::from_fn(|k| best.x[k] + change[k]);
            let chi2 = problem.evaluate(&x, &mut there);
            if chi2 < best.chi2 {
                best = FitResult { x, chi2 };
                std::mem::swap(&mut here, &mut there);
                damping = (0.2 * damping).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if before - best.chi2 < 1e-3 {
            break;
        }
    }
    best
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curved_valley_is_followed_to_its_bottom() {
        let wide = Prior {
            mean: 0.0,
            sigma: 10.0,
        };
        let found = fit(&[wide; 2], [-1.2, 1.0], 200, |x, out| {
            out.push(100.0 * (x[1] - x[0] * x[0]));
            out.push(100.0 * (1.0 - x[0]));
        });
        assert!((found.x[0] - 1.0).abs() < 1e-2, "{found:?}");
    }

    #[test]
    fn without_data_the_prior_is_found_and_nan_is_never_taken() {
        let prior = Prior {
            mean: 3.0,
            sigma: 0.5,
        };
        let found = fit(&[prior], [0.0], 20, |x, out| {
            out.push(if x[0] > 3.2 { f64::NAN } else { 0.0 });
        });
        assert!((found.x[0] - 3.0).abs() < 1e-3, "{found:?}");
    }
}
