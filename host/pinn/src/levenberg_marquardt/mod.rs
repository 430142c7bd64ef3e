//! Levenberg-Marquardt. Minimises over θ
//!
//!   F(θ) = |e(θ)|² + s |θ − c|²,
//!
//! e being the residuals of a [`LeastSquares`] problem, s and c strength and centre of a [`Prior`]. Each step
//! d solves (JᵀJ + (s + µ) I) d = −(Jᵀe + s (θ − c)); the damping µ follows Nielsen's rule (Madsen, Nielsen
//! and Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).

mod linearised;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};

use self::linearised::{Damped, Linearised};
use crate::progress::{Log, Settling, StoppedBecause};

/// First damping, compared with the largest diagonal entry of JᵀJ.
const FIRST_DAMPING: f64 = 1e-3;
/// Last damping tried, compared with the same entry: a step damped so is below rounding.
const LAST_DAMPING: f64 = 1e12;
/// Share of a step after which the bend of the residuals is looked at: long enough to be above rounding.
const PROBE: f64 = 0.1;
/// Largest second order of a step compared with it (Transtrum and Sethna's α).
const MOST_BENT: f64 = 0.75;
/// Steps over which the outputs' change is compared with the tolerance.
const SETTLING_STEPS: usize = 5;

/// A sum of squares to minimise.
pub(crate) trait LeastSquares {
    /// Why it cannot be computed.
    type Error;

    /// The residuals and outputs at these parameters; numbers that are not finite only shorten the step.
    fn evaluate(&self, theta: &[f64]) -> Result<Evaluation, Self::Error>;

    /// ∂e/∂θ at these parameters, a row a residual.
    fn jacobian(&self, theta: &[f64]) -> Result<DMatrix<f64>, Self::Error>;
}

/// A problem at one set of parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Evaluation {
    /// e.
    pub residuals: Vec<f64>,
    /// What must converge: R, L alternating, in units of their scales.
    pub outputs: Vec<f64>,
}

impl Evaluation {
    /// |e|².
    pub fn squares(&self) -> f64 {
        self.residuals.iter().map(|e| e * e).sum()
    }
}

/// What is expected of the parameters before any sample is seen.
///
/// With a strength of (variance of a residual) / (variance of a parameter) the minimum is the most probable
/// set of parameters for normal noise and normal parameters. Without noise the strength vanishes and the
/// residuals alone decide; with noise it keeps R and L from following it where the current is small.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Prior {
    /// s.
    pub strength: f64,
    /// c, as long as θ.
    pub centre: Vec<f64>,
}

/// Where the search ended.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Minimum {
    pub theta: Vec<f64>,
    /// |e|² there, without the prior.
    pub squares: f64,
    /// [`StoppedBecause::Settled`]: the outputs' mean relative change over [`SETTLING_STEPS`] steps is below
    /// the tolerance. [`StoppedBecause::NoDescent`]: no damping up to [`LAST_DAMPING`] gives a smaller F.
    /// [`StoppedBecause::RolledBack`]: F at the start is not finite; `theta` is the start. Else a limit of
    /// the log.
    pub stopped: StoppedBecause,
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
        return Ok(at.ends(StoppedBecause::RolledBack));
    }
    let mut settling = Settling::over(SETTLING_STEPS);
    settling.change(at.value.outputs.clone());
    let mut damping = Damping::default();
    loop {
        if let Some(limit) = log.exhausted() {
            return Ok(at.ends(limit));
        }
        let model = Linearised::new(problem.jacobian(&at.theta)?, &at, prior);
        let Some(next) = damping.search(problem, prior, &at, &model)? else {
            return Ok(at.ends(StoppedBecause::NoDescent));
        };
        at = next;
        let change = settling.change(at.value.outputs.clone());
        log.record(at.value.squares(), change, &at.value.outputs);
        if change < tolerance {
            return Ok(at.ends(StoppedBecause::Settled));
        }
    }
}

/// One set of parameters and what it gives.
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

    fn ends(self, stopped: StoppedBecause) -> Minimum {
        Minimum {
            squares: self.value.squares(),
            theta: self.theta,
            stopped,
        }
    }
}

/// µ and how fast it grows. Nielsen's rule: the ratio of actual to predicted descent sets µ, so that it moves
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
    /// Damps more and more until a step descends; nothing if none does.
    fn search<P: LeastSquares>(
        &mut self,
        problem: &P,
        prior: &Prior,
        at: &Point,
        model: &Linearised,
    ) -> Result<Option<Point>, P::Error> {
        let mut mu = self.mu.unwrap_or(FIRST_DAMPING * model.scale);
        while mu < LAST_DAMPING * model.scale {
            // No step: JᵀJ + µI lost its definiteness to rounding.
            if let Some(damped) = model.damped(mu) {
                let step = damped.step();
                let path = bent(problem, at, &damped, &step)?;
                let next = Point::new(problem, prior, at.moved(&path, 1.0))?;
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

/// The step with its second order, where that is small against it: else neither holds that far.
fn bent<P: LeastSquares>(
    problem: &P,
    at: &Point,
    damped: &Damped<'_>,
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
    // A NaN fails this too.
    if 2.0 * acceleration.norm() <= MOST_BENT * step.norm() {
        return Ok(step + acceleration * 0.5);
    }
    Ok(step.clone())
}
