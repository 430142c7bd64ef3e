//! Levenberg-Marquardt on the physics residuals of the RL-MLP.

use nalgebra::{DMatrix, DVector};

use crate::PinnError;
use crate::jacobian::jacobian;
use crate::loss::SlowTensors;
use crate::parameters::Parameters;
use crate::progress::{Log, Settling, StoppedBecause};
use crate::rl_mlp::RlMlp;

/// First damping, relative to the largest diagonal entry of J^T J.
const FIRST_DAMPING: f64 = 1e-3;
/// Damping, relative as above, at which a step is below rounding.
const LAST_DAMPING: f64 = 1e12;
/// Steps over which R and L must rest.
const SETTLING_STEPS: usize = 5;

/// Where an optimiser ended.
pub(crate) struct Descent {
    pub parameters: Parameters,
    /// Sum of squared residuals there.
    pub squares: f64,
    pub stopped: StoppedBecause,
}

/// Minimises the residuals of `physics` from `parameters` on.
///
/// Damping follows Nielsen's rule: the gain ratio of actual to predicted descent sets it, so that
/// it moves smoothly instead of by factors of ten.
pub(crate) fn descend(
    physics: &SlowTensors,
    parameters: Parameters,
    tolerance: f64,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    let (mut residuals, outputs) = physics.evaluate(&parameters)?;
    let mut at = Descent {
        parameters,
        squares: squared(&residuals),
        stopped: StoppedBecause::RolledBack,
    };
    if !at.squares.is_finite() {
        return Ok(at);
    }
    let mut settling = Settling::over(SETTLING_STEPS);
    settling.change(outputs);
    let (mut damping, mut growth) = (None, 2.0);
    loop {
        if let Some(limit) = log.exhausted() {
            at.stopped = limit;
            return Ok(at);
        }
        let network = RlMlp::from_parameters(&at.parameters, &physics.device);
        let model = Linearised::new(jacobian(physics, &network)?, &residuals);
        let mut mu: f64 = *damping.get_or_insert(FIRST_DAMPING * model.scale);
        let accepted = loop {
            let Some(step) = model.step(mu) else {
                // J^T J + mu I lost its definiteness to rounding: damp more.
                mu *= growth;
                growth *= 2.0;
                if mu > LAST_DAMPING * model.scale {
                    break None;
                }
                continue;
            };
            let next = moved(&at.parameters, &step);
            let (e, y) = physics.evaluate(&next)?;
            let gain = (at.squares - squared(&e)) / model.predicted_descent(&step, mu);
            // A NaN or infinite loss fails this too, and so is never accepted.
            if gain > 0.0 && squared(&e) < at.squares {
                mu *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
                growth = 2.0;
                break Some((next, e, y));
            }
            mu *= growth;
            growth *= 2.0;
            if !(mu < LAST_DAMPING * model.scale) {
                break None;
            }
        };
        damping = Some(mu);
        let Some((next, e, y)) = accepted else {
            at.stopped = StoppedBecause::NoDescent;
            return Ok(at);
        };
        at.parameters = next;
        at.squares = squared(&e);
        residuals = e;
        let change = settling.change(y);
        log.record(at.squares, change);
        if change < tolerance {
            at.stopped = StoppedBecause::Settled;
            return Ok(at);
        }
    }
}

fn squared(residuals: &[f64]) -> f64 {
    residuals.iter().map(|e| e * e).sum()
}

fn moved(parameters: &Parameters, step: &DVector<f64>) -> Parameters {
    let flat: Vec<f64> = parameters
        .flat()
        .iter()
        .zip(step.iter())
        .map(|(x, d)| x + d)
        .collect();
    parameters.with_flat(&flat)
}

/// The residuals around one point: `e + J d`.
struct Linearised {
    /// J^T, one column per residual.
    transposed: DMatrix<f64>,
    residuals: DVector<f64>,
    /// J^T e.
    gradient: DVector<f64>,
    /// J^T J, or J J^T where there are more parameters than residuals.
    product: DMatrix<f64>,
    wide: bool,
    /// Largest diagonal entry of the product: the scale of the damping.
    scale: f64,
}

impl Linearised {
    /// `rows` is J, row by row.
    fn new(rows: Vec<f64>, residuals: &[f64]) -> Self {
        let parameters = rows.len() / residuals.len();
        let transposed = DMatrix::from_vec(parameters, residuals.len(), rows);
        let residuals = DVector::from_column_slice(residuals);
        let gradient = &transposed * &residuals;
        let wide = parameters > residuals.len();
        let across = transposed.transpose();
        let product = if wide {
            &across * &transposed
        } else {
            &transposed * &across
        };
        let scale = product.diagonal().max().max(f64::MIN_POSITIVE);
        Self {
            transposed,
            residuals,
            gradient,
            product,
            wide,
            scale,
        }
    }

    /// The minimiser of `|e + J d|^2 + mu |d|^2`, or nothing if rounding forbids it.
    fn step(&self, mu: f64) -> Option<DVector<f64>> {
        let mut damped = self.product.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += mu;
        }
        let factor = damped.cholesky()?;
        // (J^T J + mu I)^-1 J^T = J^T (J J^T + mu I)^-1: the smaller system of the two.
        Some(if self.wide {
            -(&self.transposed * factor.solve(&self.residuals))
        } else {
            -factor.solve(&self.gradient)
        })
    }

    /// `|e|^2 - |e + J d|^2`, which for this d equals `d^T (mu d - J^T e)`.
    fn predicted_descent(&self, step: &DVector<f64>, mu: f64) -> f64 {
        step.dot(&(step * mu - &self.gradient))
    }
}
