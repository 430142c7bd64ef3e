//! Levenberg-Marquardt. Minimises over θ
//!
//!   F(θ) = |e(θ)|² + s |θ − c|²,
//!
//! e being the residuals of a [`LeastSquares`] problem, s and c strength and centre of a [`Prior`]. Each step
//! d solves (JᵀJ + (s + µ) I) d = −(Jᵀe + s (θ − c)); the damping µ follows Nielsen's rule (Madsen, Nielsen
//! and Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).

mod linearised;
mod problem;
#[cfg(test)]
mod tests;

use nalgebra::DVector;

use self::linearised::{DampedModel, LinearModel};
pub(crate) use self::problem::{Evaluation, LeastSquares, Prior};
use crate::progress::{Log, Settling, StopReason};

/// Initial damping relative to the largest diagonal entry of JᵀJ.
const FIRST_DAMPING: f64 = 1e-3;
/// Largest damping relative to the same entry: a step damped so much is below rounding.
const LAST_DAMPING: f64 = 1e12;
/// Share of a step at which the second derivative of the residuals is computed: long enough to be above rounding.
const PROBE: f64 = 0.1;
/// Largest second order of a step relative to it (Transtrum and Sethna's α).
const MAX_BEND_RATIO: f64 = 0.75;
/// Steps over which the outputs' change is compared with the tolerance.
const SETTLING_STEPS: usize = 2;

/// Result of the search.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Minimum {
    pub theta: Vec<f64>,
    /// |e|² at `theta`, without the prior.
    pub squares: f64,
    /// [`StopReason::Settled`]: the outputs' mean relative change over [`SETTLING_STEPS`] steps is below
    /// the tolerance. [`StopReason::NoDescent`]: no damping up to [`LAST_DAMPING`] gives a smaller F.
    /// [`StopReason::RolledBack`]: F at the start is not finite; `theta` is the start. Else a limit of
    /// the log.
    pub stopped: StopReason,
}

/// Minimises F from `theta` on. `tolerance` is compared with the outputs' mean relative change over the last
/// [`SETTLING_STEPS`] steps, the larger of R's and L's; `log` counts accepted steps and sets their limits.
pub(crate) fn minimise<P: LeastSquares>(
    problem: &P,
    theta: Vec<f64>,
    prior: &Prior,
    tolerance: f64,
    log: &mut Log<'_>,
) -> Result<Minimum, P::Error> {
    let mut at = Point::new(problem, prior, theta)?;
    if !at.cost.is_finite() {
        return Ok(at.ends(StopReason::RolledBack));
    }
    let mut settling = Settling::over(SETTLING_STEPS);
    settling.change(at.value.outputs.clone());
    let mut damping = Damping::default();
    loop {
        if let Some(limit) = log.exhausted() {
            return Ok(at.ends(limit));
        }
        let model = LinearModel::new(
            problem.jacobian(&at.theta)?,
            &at.theta,
            &at.value.residuals,
            prior,
        );
        let Some(next) = damping.search(problem, prior, &at, &model)? else {
            return Ok(at.ends(StopReason::NoDescent));
        };
        at = next;
        let change = settling.change(at.value.outputs.clone());
        log.record(at.value.squares(), change, &at.value.outputs);
        if change < tolerance {
            return Ok(at.ends(StopReason::Settled));
        }
    }
}

/// Set of parameters with its residuals and cost.
struct Point {
    theta: Vec<f64>,
    value: Evaluation,
    /// F.
    cost: f64,
}

impl Point {
    fn new<P: LeastSquares>(problem: &P, prior: &Prior, theta: Vec<f64>) -> Result<Self, P::Error> {
        let value = problem.evaluate(&theta)?;
        let pull = prior.strength * prior.distance(&theta).norm_squared();
        Ok(Self {
            cost: value.squares() + pull,
            theta,
            value,
        })
    }

    /// θ + `share` · `step`.
    fn moved(&self, step: &DVector<f64>, share: f64) -> Vec<f64> {
        let both = self.theta.iter().zip(step.iter());
        both.map(|(x, d)| x + share * d).collect()
    }

    fn ends(self, stopped: StopReason) -> Minimum {
        Minimum {
            squares: self.value.squares(),
            theta: self.theta,
            stopped,
        }
    }
}

/// µ and its growth. Nielsen's rule: the ratio of actual to predicted descent sets µ, which therefore changes
/// smoothly instead of by factors of ten.
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
    /// Increases the damping until a step descends; `None` if none does.
    fn search<P: LeastSquares>(
        &mut self,
        problem: &P,
        prior: &Prior,
        at: &Point,
        model: &LinearModel,
    ) -> Result<Option<Point>, P::Error> {
        let mut mu = self.mu.unwrap_or(FIRST_DAMPING * model.scale);
        while mu < LAST_DAMPING * model.scale {
            // No step if JᵀJ + µI lost its definiteness to rounding.
            if let Some(damped) = model.damped(mu) {
                let step = damped.step();
                let path = bent(problem, at, &damped, &step)?;
                let next = Point::new(problem, prior, at.moved(&path, 1.0))?;
                let gain = (at.cost - next.cost) / model.predicted_descent(&step, mu);
                // The comparison is false for a NaN cost, which is therefore never accepted.
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

/// Step with its second order if that is small relative to it; else the expansion does not hold so far.
fn bent<P: LeastSquares>(
    problem: &P,
    at: &Point,
    damped: &DampedModel<'_>,
    step: &DVector<f64>,
) -> Result<DVector<f64>, P::Error> {
    let ahead = problem.evaluate(&at.moved(step, PROBE))?.residuals;
    let slope = damped.slope(step);
    let here = at.value.residuals.iter().zip(&slope);
    let bend: Vec<f64> = ahead
        .iter()
        .zip(here)
        .map(|(ahead, (here, slope))| 2.0 / PROBE * ((ahead - here) / PROBE - slope))
        .collect();
    let acceleration = damped.acceleration(&bend);
    // The comparison is false for NaN.
    if 2.0 * acceleration.norm() <= MAX_BEND_RATIO * step.norm() {
        return Ok(step + acceleration * 0.5);
    }
    Ok(step.clone())
}
