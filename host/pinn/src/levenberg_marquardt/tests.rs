//! Problems with solutions in closed form.

use std::convert::Infallible;

use nalgebra::DMatrix;

use super::{Evaluation, LeastSquares, Minimum, Prior, minimise};
use crate::PinnConfig;
use crate::derivatives::Derivatives;
use crate::progress::{Log, StopReason};

/// Residuals and Jacobian as functions; the parameters are the outputs.
struct Plain<E, J> {
    residuals: E,
    rows: J,
}

impl<E, J> LeastSquares for Plain<E, J>
where
    E: Fn(&[f64]) -> Vec<f64>,
    J: Fn(&[f64]) -> Vec<f64>,
{
    type Error = Infallible;

    fn evaluate(&self, theta: &[f64]) -> Result<Evaluation, Infallible> {
        Ok(Evaluation {
            residuals: (self.residuals)(theta),
            outputs: theta.to_vec(),
        })
    }

    fn jacobian(&self, theta: &[f64]) -> Result<Derivatives, Infallible> {
        let rows = (self.rows)(theta);
        let count = rows.len() / theta.len();
        let rows = DMatrix::from_row_slice(count, theta.len(), &rows);
        Ok(Derivatives::Matrix(rows))
    }
}

/// More and Garbow's first problem: minimum 0 at (1, 1), along a bent valley.
fn rosenbrock() -> impl LeastSquares<Error = Infallible> {
    Plain {
        residuals: |t: &[f64]| vec![10.0 * (t[1] - t[0] * t[0]), 1.0 - t[0]],
        rows: |t: &[f64]| vec![-20.0 * t[0], 10.0, -1.0, 0.0],
    }
}

/// a e^(−bt) at twenty times, against a = 3, b = 0.7.
fn exponential() -> impl LeastSquares<Error = Infallible> {
    let times = || (0..20).map(|k| 0.25 * f64::from(k));
    Plain {
        residuals: move |x: &[f64]| {
            let right = |t: f64| 3.0 * (-0.7 * t).exp();
            times()
                .map(|t| x[0] * (-x[1] * t).exp() - right(t))
                .collect()
        },
        rows: move |x: &[f64]| {
            let row = |t: f64| [(-x[1] * t).exp(), -x[0] * t * (-x[1] * t).exp()];
            times().flat_map(row).collect()
        },
    }
}

/// The line through (0, 1), (1, 3), (2, 4): offset 7/6 and slope 3/2 fit best.
fn line() -> impl LeastSquares<Error = Infallible> {
    Plain {
        residuals: |x: &[f64]| vec![x[0] - 1.0, x[0] + x[1] - 3.0, x[0] + 2.0 * x[1] - 4.0],
        rows: |_: &[f64]| vec![1.0, 0.0, 1.0, 1.0, 1.0, 2.0],
    }
}

fn no_prior(count: usize) -> Prior {
    Prior {
        strength: 0.0,
        centre: vec![0.0; count],
    }
}

fn minimum(
    problem: &impl LeastSquares<Error = Infallible>,
    theta: &[f64],
    prior: &Prior,
    tolerance: f64,
    steps: usize,
) -> (Minimum, usize) {
    let config = PinnConfig {
        max_iterations: steps,
        deterministic: true,
        ..PinnConfig::default()
    };
    let mut report = |_: &_| {};
    let mut log = Log::start(&config, &mut report);
    let Ok(found) = minimise(problem, theta.to_vec(), prior, tolerance, &mut log);
    (found, log.iteration)
}

fn assert_near(found: &[f64], right: &[f64], tolerance: f64) {
    assert_eq!(found.len(), right.len());
    for (a, b) in found.iter().zip(right) {
        assert!((a - b).abs() < tolerance, "{found:?} against {right:?}");
    }
}

#[test]
fn rosenbrocks_valley_is_walked_to_its_end() {
    let (found, steps) = minimum(&rosenbrock(), &[-1.2, 1.0], &no_prior(2), 1e-12, 200);
    assert_near(&found.theta, &[1.0, 1.0], 1e-9);
    assert!(found.stopped.is_converged() && found.squares < 1e-18);
    // MINPACK's lmder takes 16; plain descent thousands.
    assert!(steps <= 40, "{steps} steps");
}

#[test]
fn an_exponential_without_noise_is_found_from_far_off() {
    let (found, _) = minimum(&exponential(), &[0.5, 3.0], &no_prior(2), 1e-12, 200);
    assert_near(&found.theta, &[3.0, 0.7], 1e-9);
    assert!(found.stopped.is_converged());
}

#[test]
fn the_jacobians_of_these_tests_are_finite_differences() {
    fn check(problem: &impl LeastSquares<Error = Infallible>, theta: &[f64]) {
        let Ok(rows) = problem.jacobian(theta).map(|j| j.dense().into_owned());
        for p in 0..theta.len() {
            let at = |shift: f64| {
                let mut moved = theta.to_vec();
                moved[p] += shift;
                let Ok(value) = problem.evaluate(&moved);
                value.residuals
            };
            for (k, (after, before)) in at(1e-6).iter().zip(at(-1e-6)).enumerate() {
                let numeric = (after - before) / 2e-6;
                assert!((numeric - rows[(k, p)]).abs() < 1e-7);
            }
        }
    }
    check(&rosenbrock(), &[-1.2, 1.0]);
    check(&exponential(), &[0.5, 3.0]);
    check(&line(), &[0.0, 0.0]);
}

#[test]
fn a_prior_pulls_as_far_as_the_ridge_of_the_normal_equations() {
    let (found, _) = minimum(&line(), &[0.0, 0.0], &no_prior(2), 1e-12, 200);
    assert_near(&found.theta, &[7.0 / 6.0, 1.5], 1e-7);
    // (JᵀJ + I) θ = Jᵀb + c with JᵀJ = [3 3; 3 5], Jᵀb = (8, 11), c = (4, 0).
    let prior = Prior {
        strength: 1.0,
        centre: vec![4.0, 0.0],
    };
    let (found, _) = minimum(&line(), &[0.0, 0.0], &prior, 1e-12, 200);
    assert_near(&found.theta, &[39.0 / 15.0, 8.0 / 15.0], 1e-7);
    let sum =
        |x: f64, y: f64| (x - 1.0).powi(2) + (x + y - 3.0).powi(2) + (x + 2.0 * y - 4.0).powi(2);
    let right = sum(39.0 / 15.0, 8.0 / 15.0);
    assert!(
        (found.squares - right).abs() < 1e-7,
        "without the prior's part"
    );
}

#[test]
fn more_parameters_than_residuals_give_the_solution_nearest_to_the_start() {
    // x + 2y + 2z = 9 from the origin: the foot of its normal, (1, 2, 2).
    let plane = Plain {
        residuals: |x: &[f64]| vec![x[0] + 2.0 * x[1] + 2.0 * x[2] - 9.0],
        rows: |_: &[f64]| vec![1.0, 2.0, 2.0],
    };
    let (found, _) = minimum(&plane, &[0.0; 3], &no_prior(3), 1e-12, 200);
    assert_near(&found.theta, &[1.0, 2.0, 2.0], 1e-9);
}

#[test]
fn every_ending_has_its_name() {
    let ends = |theta: &[f64], tolerance, steps| {
        minimum(&rosenbrock(), theta, &no_prior(2), tolerance, steps).0
    };
    let settled = ends(&[-1.2, 1.0], 1e-3, 200);
    assert_eq!(settled.stopped, StopReason::Settled);
    let exact = ends(&[1.0, 1.0], 0.0, 200);
    assert_eq!(exact.stopped, StopReason::NoDescent);
    assert_eq!(exact.theta, [1.0, 1.0]);
    let short = ends(&[-1.2, 1.0], 1e-12, 3);
    assert_eq!(short.stopped, StopReason::IterationLimit);
    // The start squared overflows: no step was made.
    let far = ends(&[1e200, 1.0], 1e-12, 200);
    assert_eq!(far.stopped, StopReason::RolledBack);
    assert_eq!(far.theta, [1e200, 1.0]);
}

#[test]
fn steps_into_nonsense_are_shortened() {
    // ln x against ln 2, which a full step from 20 leaves for x < 0: NaN.
    let logarithm = Plain {
        residuals: |x: &[f64]| vec![x[0].ln() - 2.0_f64.ln(), 0.0],
        rows: |x: &[f64]| vec![1.0 / x[0], 0.0],
    };
    let (found, _) = minimum(&logarithm, &[20.0], &no_prior(1), 1e-12, 200);
    assert_near(&found.theta, &[2.0], 1e-9);
}
