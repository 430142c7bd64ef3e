//! Levenberg-Marquardt on the physics residuals of the RL-MLP.

use nalgebra::{DMatrix, DVector};

use crate::PinnError;
use crate::parameters::Parameters;
use crate::progress::{Log, Settling, StoppedBecause};
use crate::slow_model::SlowModel;

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

/// What is expected of the weights before any sample is seen: `strength * |theta - centre|^2` is
/// added to the squared residuals.
///
/// With a strength of (variance of a residual) / (variance of a weight) the minimum is the most
/// probable network for normal noise and normal weights. Without noise the strength vanishes and
/// eq. (7) alone decides; with noise it keeps R and L from following it where the current is small.
pub(crate) struct Prior {
    pub strength: f64,
    pub centre: Vec<f64>,
}

impl Prior {
    /// theta - centre.
    fn distance(&self, parameters: &Parameters) -> DVector<f64> {
        let flat = parameters.flat();
        DVector::from_iterator(
            flat.len(),
            flat.iter().zip(&self.centre).map(|(x, c)| x - c),
        )
    }
}

/// One set of parameters and what it gives.
struct Trial {
    parameters: Parameters,
    residuals: Vec<f64>,
    /// R / r_scale and L / l_scale, alternating.
    outputs: Vec<f64>,
    /// Squared residuals and prior: what is minimised.
    cost: f64,
}

impl Trial {
    fn of(physics: &SlowModel, prior: &Prior, parameters: Parameters) -> Result<Self, PinnError> {
        let (residuals, outputs) = physics.evaluate(&parameters)?;
        let pull = prior.strength * prior.distance(&parameters).norm_squared();
        Ok(Self {
            cost: squared(&residuals) + pull,
            parameters,
            residuals,
            outputs,
        })
    }

    fn ends(self, stopped: StoppedBecause) -> Descent {
        Descent {
            squares: squared(&self.residuals),
            parameters: self.parameters,
            stopped,
        }
    }
}

/// Minimises the residuals of `physics` and the `prior` from `parameters` on.
pub(crate) fn descend(
    physics: &SlowModel,
    parameters: Parameters,
    prior: &Prior,
    tolerance: f64,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    let mut at = Trial::of(physics, prior, parameters)?;
    if !at.cost.is_finite() {
        // Only a warm start can be that far off: the constant network is the last good one.
        let constant = at.parameters.with_flat(&prior.centre);
        let constant = Trial::of(physics, prior, constant)?;
        return Ok(constant.ends(StoppedBecause::RolledBack));
    }
    let mut settling = Settling::over(SETTLING_STEPS);
    settling.change(at.outputs.clone());
    let mut damping = Damping::default();
    loop {
        if let Some(limit) = log.exhausted() {
            return Ok(at.ends(limit));
        }
        let rows = physics.jacobian(&at.parameters)?;
        let model = Linearised::new(rows, &at, prior);
        let Some(next) = damping.search(physics, prior, &at, &model)? else {
            return Ok(at.ends(StoppedBecause::NoDescent));
        };
        at = next;
        let change = settling.change(at.outputs.clone());
        log.record(squared(&at.residuals), change, &at.outputs);
        if change < tolerance {
            return Ok(at.ends(StoppedBecause::Settled));
        }
    }
}

/// Damping after Nielsen's rule: the ratio of actual to predicted descent sets it, so that it
/// moves smoothly instead of by factors of ten.
struct Damping {
    mu: Option<f64>,
    growth: f64,
}

impl Default for Damping {
    fn default() -> Self {
        Self {
            mu: None,
            growth: 2.0,
        }
    }
}

impl Damping {
    /// Damps more and more until a step descends; nothing if none does.
    fn search(
        &mut self,
        physics: &SlowModel,
        prior: &Prior,
        at: &Trial,
        model: &Linearised,
    ) -> Result<Option<Trial>, PinnError> {
        let mut mu = self.mu.unwrap_or(FIRST_DAMPING * model.scale);
        while mu < LAST_DAMPING * model.scale {
            // No step: J^T J + mu I lost its definiteness to rounding.
            if let Some(step) = model.step(mu) {
                let next = Trial::of(physics, prior, moved(&at.parameters, &step))?;
                let gain = (at.cost - next.cost) / model.predicted_descent(&step, mu);
                // A NaN or infinite cost fails this too, and so is never accepted.
                if gain > 0.0 && next.cost < at.cost {
                    self.mu = Some(mu * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0));
                    self.growth = 2.0;
                    return Ok(Some(next));
                }
            }
            mu *= self.growth;
            self.growth *= 2.0;
        }
        Ok(None)
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

/// The residuals around one point, `e + J d`, and the prior's pull.
struct Linearised {
    /// J^T, one column per residual.
    transposed: DMatrix<f64>,
    /// Half the gradient of the cost: `J^T e + strength (theta - centre)`.
    gradient: DVector<f64>,
    /// J^T J, or J J^T where there are more parameters than residuals.
    product: DMatrix<f64>,
    wide: bool,
    strength: f64,
    /// Largest diagonal entry of the product: the scale of the damping.
    scale: f64,
}

impl Linearised {
    /// `rows` is J, row by row.
    fn new(rows: Vec<f64>, at: &Trial, prior: &Prior) -> Self {
        let pull = prior.distance(&at.parameters) * prior.strength;
        let (parameters, residuals) = (pull.len(), at.residuals.len());
        let transposed = DMatrix::from_vec(parameters, residuals, rows);
        let gradient = &transposed * DVector::from_column_slice(&at.residuals) + pull;
        let wide = parameters > residuals;
        let across = transposed.transpose();
        let product = if wide {
            &across * &transposed
        } else {
            &transposed * &across
        };
        let scale = product.diagonal().max().max(f64::MIN_POSITIVE);
        Self {
            transposed,
            gradient,
            product,
            wide,
            strength: prior.strength,
            scale,
        }
    }

    /// The minimiser of the linearised cost plus `mu |d|^2`, or nothing if rounding forbids it.
    fn step(&self, mu: f64) -> Option<DVector<f64>> {
        let ridge = self.strength + mu;
        let mut damped = self.product.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += ridge;
        }
        let factor = damped.cholesky()?;
        if !self.wide {
            return Some(-factor.solve(&self.gradient));
        }
        // (J^T J + a I)^-1 = (I - J^T (J J^T + a I)^-1 J) / a: the smaller system of the two.
        let seen = factor.solve(&self.transposed.tr_mul(&self.gradient));
        Some((&self.transposed * seen - &self.gradient) / ridge)
    }

    /// Descent of the linearised cost along `step`: for this step `d^T (mu d - gradient)`.
    fn predicted_descent(&self, step: &DVector<f64>, mu: f64) -> f64 {
        step.dot(&(step * mu - &self.gradient))
    }
}
