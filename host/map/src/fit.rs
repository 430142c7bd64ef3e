//! Least-squares fit of a pot's numbers to measured data, with the misfit of the physics as correlated noise and a prior on
//! the numbers.

use ihd_signal::Load;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::PotModel;
use crate::curve::common_covariance;
use crate::heat::changes;
use crate::misfit::MapPoint;
use crate::parameters::{self, CENTRED, COUNT, Prior, Vector};
use crate::pot_model::FrequencyModel;

/// Most steps of a descent.
pub(crate) const MAX_STEPS: usize = 12;

/// Fall of the cost at which a descent ends: a number then moves far less than its deviation.
const COST_TOLERANCE: f64 = 1e-3;

/// Measured ln R and ln L at a place, with variances.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Datum {
    pub f_hz: f64,
    pub i_a: f64,
    pub ln: [f64; 2],
    pub variance: [f64; 2],
    /// Variances that all data of one frequency share.
    pub level: [f64; 2],
    /// Deviations that all data share.
    pub common: [f64; 2],
    /// Age in seconds; negative ahead of now.
    pub age_s: f64,
}

impl Datum {
    pub fn place(&self) -> MapPoint {
        MapPoint::new(self.f_hz, self.i_a).aged(self.age_s)
    }
}

/// ln R and ln L of a model at each datum: R of all, then L of all. Data of one frequency must be adjacent.
fn predicted(model: &PotModel, data: &[Datum]) -> DVector<f64> {
    let count = data.len();
    let mut all = DVector::zeros(2 * count);
    for_each(model, data, |k, at, i_a| {
        (all[k], all[count + k]) = ln_of(at.impedance(i_a));
    });
    all
}

/// Calls `take` with each datum's position, the model at its frequency, and its current; a field is the next one's start.
fn for_each(
    model: &PotModel,
    data: &[Datum],
    mut take: impl FnMut(usize, &mut FrequencyModel, f64),
) {
    let mut k = 0;
    for same in data.chunk_by(|a, b| a.f_hz == b.f_hz) {
        let mut at = model.at_frequency(same[0].f_hz);
        for datum in same {
            take(k, &mut at, datum.i_a);
            k += 1;
        }
    }
}

/// Predictions at the data from a prior and steps, linearised there.
pub(crate) struct Linearised {
    /// ln R of all data, then ln L of all.
    pub ln: DVector<f64>,
    /// Slopes by the first numbers, per spread.
    pub slopes: DMatrix<f64>,
    /// Changes by heating.
    pub heat: Heat,
}

impl Linearised {
    /// Linearises by the first `used` numbers. Data of one frequency must be adjacent.
    pub fn at((prior, steps): (&Prior, &Vector), data: &[Datum], used: usize) -> Self {
        let (model, count) = (parameters::moved(prior, steps), data.len());
        let mut ln = DVector::zeros(2 * count);
        let mut by_numbers = DMatrix::zeros(2 * count, COUNT);
        for_each(&model, data, |k, at, i_a| {
            let (load, by) = at.sensitivities(i_a);
            (ln[k], ln[count + k]) = ln_of(load);
            for (n, by) in parameters::of_numbers(&by).into_iter().enumerate() {
                (by_numbers[(k, n)], by_numbers[(count + k, n)]) = (by.ln_r, by.ln_l);
            }
        });
        let spreads = DMatrix::from_fn(COUNT, used, |row, k| {
            parameters::column(&prior.spread, k)[row]
        });
        Self {
            ln,
            slopes: &by_numbers * spreads,
            heat: Heat {
                per_ln_s: by_numbers.column(parameters::LN_S).into(),
                ages_s: data.iter().map(|d| d.age_s).collect(),
            },
        }
    }
}

fn ln_of(load: Load) -> (f64, f64) {
    (load.r_ohm.max(1e-6).ln(), load.l_h.max(1e-9).ln())
}

/// Logarithm of the evidence of data that deviate from their expectation by `left`, up to a constant, and covariance⁻¹ · `left`.
pub(crate) fn log_evidence(
    covariance: &Cholesky<f64, Dyn>,
    left: &DVector<f64>,
) -> (f64, DVector<f64>) {
    let weights = covariance.solve(left);
    let factor = covariance.l_dirty().diagonal();
    let half_ln_determinant: f64 = factor.iter().map(|x| x.ln()).sum();
    (-0.5 * left.dot(&weights) - half_ln_determinant, weights)
}

/// Covariance of measured data around the physics: errors of measurement, the level of each curve, what all have in common, and
/// the misfit of deviations `tau`.
pub(crate) fn covariance(data: &[Datum], tau: [f64; 2]) -> DMatrix<f64> {
    let count = data.len();
    let places: Vec<MapPoint> = data.iter().map(Datum::place).collect();
    let mut all = DMatrix::zeros(2 * count, 2 * count);
    for m in 0..count {
        for n in 0..=m {
            let correlation = places[m].correlation(places[n]);
            for (x, tau) in tau.iter().enumerate() {
                let (row, column) = (x * count + m, x * count + n);
                let shared = data[m].f_hz == data[n].f_hz;
                let level = if shared {
                    data[m].level[x].min(data[n].level[x])
                } else {
                    0.0
                };
                let common = common_covariance(data[m].common[x], data[n].common[x]);
                all[(row, column)] = tau * tau * correlation + level + common;
                all[(column, row)] = all[(row, column)];
            }
        }
        for x in 0..2 {
            all[(x * count + m, x * count + m)] += data[m].variance[x];
        }
    }
    all
}

/// Result of a descent.
#[derive(Clone, Debug)]
pub(crate) struct Descent {
    /// Prior of the numbers.
    pub prior: Prior,
    /// Fitted numbers, in spreads from the prior's mean.
    pub steps: Vector,
    /// Number of free parameters.
    pub used: usize,
    /// Half of the remaining squares.
    pub cost: f64,
}

/// Measured data of a descent, with the factor of their covariance.
struct Whitened {
    seen: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Whitened {
    /// Half of the squares that predictions leave, and of the steps from the prior.
    fn cost(&self, steps: &Vector, predicted: &DVector<f64>) -> Option<f64> {
        let left = &self.seen - predicted;
        let whitened = self.factor.l_dirty().solve_lower_triangular(&left)?;
        let believed: f64 = steps.iter().map(|s| s * s).sum();
        Some(0.5 * (whitened.norm_squared() + believed))
    }

    /// Normal matrix of the data alone, and the right-hand side with the prior.
    fn normal(&self, here: &Linearised, steps: &Vector) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let left = &self.seen - &here.ln;
        let slopes = self.factor.l_dirty().solve_lower_triangular(&here.slopes)?;
        let left = self.factor.l_dirty().solve_lower_triangular(&left)?;
        let mut right = slopes.tr_mul(&left);
        for k in 0..right.len() {
            right[k] -= steps[k];
        }
        Some((slopes.tr_mul(&slopes), right))
    }
}

/// Descends from the steps given with a prior; the first `used` numbers are free. `None` if the covariance is singular.
pub(crate) fn fit(
    data: &[Datum],
    (prior, begin): (&Prior, Vector),
    used: usize,
    tau: [f64; 2],
    most_steps: usize,
) -> Option<Descent> {
    let mut here = Linearised::at((prior, &begin), data, used);
    let white = Whitened {
        seen: measured(data),
        factor: (covariance(data, tau) + here.heat.covariance()).cholesky()?,
    };
    let mut steps = begin;
    let mut best = white.cost(&steps, &here.ln)?;
    let mut damping = 1e-2;
    for _ in 0..most_steps.min(MAX_STEPS) {
        let (normal, right) = white.normal(&here, &steps)?;
        let before = best;
        for _ in 0..6 {
            let mut damped = normal.clone();
            for k in 0..used {
                damped[(k, k)] += 1.0 + damping * (1.0 + normal[(k, k)]);
            }
            let change = damped.cholesky()?.solve(&right);
            let mut there = steps;
            for k in 0..used {
                there[k] += change[k];
            }
            // Clamped to the numbers' ranges, so that the prior counts the step that was made.
            there = parameters::steps(prior, &parameters::moved(prior, &there));
            let expected = predicted(&parameters::moved(prior, &there), data);
            let next = white.cost(&there, &expected)?;
            if next < best {
                (steps, best) = (there, next);
                damping = (damping * 0.2).max(1e-6);
                break;
            }
            damping *= 8.0;
        }
        if before - best < COST_TOLERANCE {
            break;
        }
        here = Linearised::at((prior, &steps), data, used);
    }
    Some(Descent {
        prior: *prior,
        steps,
        used,
        cost: best,
    })
}

/// Measured ln R of all data, then ln L of all.
pub(crate) fn measured(data: &[Datum]) -> DVector<f64> {
    let count = data.len();
    DVector::from_fn(2 * count, |k, _| data[k % count].ln[k / count])
}

/// Fits all classes of pots and keeps the best; off centre only if nothing else explains the data.
pub(crate) fn fit_any(data: &[Datum], tau: [f64; 2]) -> Option<Descent> {
    /// Steps of the first descent of each class.
    const FIRST_DESCENT_STEPS: usize = 3;
    let begin = [0.0; COUNT];
    let looks = parameters::classes().filter_map(|class| {
        fit(
            data,
            (&class.into(), begin),
            CENTRED,
            tau,
            FIRST_DESCENT_STEPS,
        )
    });
    let best = looks.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    fit(data, (&best.prior, best.steps), CENTRED, tau, MAX_STEPS)
}

/// Fits the same pot off centre; `None` if that is not better by more than chance.
pub(crate) fn fit_off_centre(data: &[Datum], centred: &Descent, tau: [f64; 2]) -> Option<Descent> {
    /// Least fall of the cost that justifies another parameter.
    const MIN_COST_FALL: f64 = 4.0;
    let mut begin = centred.steps;
    begin[CENTRED] = 1.0;
    let shifted = fit(data, (&centred.prior, begin), COUNT, tau, MAX_STEPS)?;
    (shifted.cost + MIN_COST_FALL < centred.cost).then_some(shifted)
}

/// Changes of ln R and ln L by heating between each datum and now.
pub(crate) struct Heat {
    /// Change of ln R and ln L for one of ln s.
    per_ln_s: DVector<f64>,
    ages_s: Vec<f64>,
}

impl Heat {
    /// Variance of one row: ln R of all data, then ln L of all.
    pub fn variance(&self, row: usize) -> f64 {
        let age_s = self.ages_s[row % self.ages_s.len()];
        self.per_ln_s[row].powi(2) * changes(age_s, age_s)
    }

    pub fn covariance(&self) -> DMatrix<f64> {
        let count = self.ages_s.len();
        let mut all = &self.per_ln_s * self.per_ln_s.transpose();
        for m in 0..count {
            for n in 0..count {
                let moved = changes(self.ages_s[m], self.ages_s[n]);
                for (row, column) in [
                    (m, n),
                    (count + m, n),
                    (m, count + n),
                    (count + m, count + n),
                ] {
                    all[(row, column)] *= moved;
                }
            }
        }
        all
    }
}
