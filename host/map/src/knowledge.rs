//! A fitted pot with what it leaves: R and L with their deviations at any frequency and current.
//!
//! Linear around the fit, everything is normal: numbers of the pot with their prior, the misfit, heat since something
//! was seen, errors of measurement. What is seen conditions all of it at once.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::fit::{
    Datum, Fitted, covariance, derivatives, fit, fit_any, fit_off_centre, predicted, seen,
};
use crate::misfit::Place;
use crate::parameters::{self, COUNT, Vector};

/// Deviations of ln R and ln L that the misfit may have, of which the evidence chooses. The least ones are what the
/// describing function is off by once a pot was fitted to it (docs/map.md).
const MISFITS_R: [f64; 7] = [0.004, 0.008, 0.016, 0.03, 0.06, 0.12, 0.24];
const MISFITS_L: [f64; 7] = [0.002, 0.004, 0.008, 0.016, 0.03, 0.06, 0.12];

/// Misfits from which the physics is said not to describe the pot: twice what harmonics of the current make.
pub const UNDESCRIBED: [f64; 2] = [0.025, 0.012];

/// Data that the fit itself looks at: more say nothing new of seven numbers.
const LOOKED_AT: usize = 48;

/// Change of ln s a second that heating makes: 2 K/s and half of 1.1e-3 a kelvin (docs/map.md), and after how many
/// seconds it ends.
const HEATING_PER_S: f64 = 1e-3;
const HEATING_ENDS_S: f64 = 150.0;

/// ln s step of the derivative by it.
const STEP_LN_S: f64 = 1e-3;

/// R and L somewhere, with deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Relative standard deviation of R.
    pub r_sigma: f64,
    /// Relative standard deviation of L.
    pub l_sigma: f64,
}

/// Where a fit ended, which all that is known follows from together with what was seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ended {
    /// The middle of the prior.
    from: PotModel,
    /// The pot, in spreads from there.
    steps: Vector,
    /// How many of its numbers were free.
    used: usize,
    /// Deviations of ln R and ln L around the physics.
    misfit: [f64; 2],
}

impl Ended {
    pub fn is_sound(&self) -> bool {
        let finite = self.steps.iter().chain(&self.misfit).all(|x| x.is_finite());
        let model = parameters::steps(&PotModel::PAPER, &self.from);
        finite
            && model.iter().all(|x| x.is_finite())
            && self.used <= COUNT
            && self.misfit.iter().all(|x| *x > 0.0)
    }

    /// The pot.
    pub fn model(&self) -> PotModel {
        parameters::moved(&self.from, &self.steps)
    }
}

/// What is known of one pot.
#[derive(Clone, Debug)]
pub(crate) struct Knowledge {
    ended: Ended,
    data: Vec<Datum>,
    slopes: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    /// K⁻¹ (seen − expected).
    weights: DVector<f64>,
}

impl Knowledge {
    /// From everything seen, at most some hundred data; `start` is the pot of before. `None` where there is nothing, or
    /// the numbers are beyond a Cholesky factorisation.
    pub fn of(data: Vec<Datum>, start: Option<&Ended>) -> Option<Self> {
        if data.is_empty() {
            return None;
        }
        let ended = ended(&thinned(&data), start)?;
        Self::conditioned(ended, data)
    }

    /// What follows from where a fit ended and from what was seen.
    pub fn conditioned(ended: Ended, data: Vec<Datum>) -> Option<Self> {
        let slopes = derivatives(&ended.from, &ended.steps, &data, ended.used);
        let heat = heat(&ended.model(), &data);
        let all = covariance(&data, ended.misfit)
            + &slopes * slopes.transpose()
            + &heat * heat.transpose();
        let factor = all.cholesky()?;
        // Linear in the numbers, the prior's middle would show `predicted − slopes · steps`.
        let expected = predicted(&ended.model(), &data) - &slopes * free(&ended);
        let weights = factor.solve(&(seen(&data) - expected));
        Some(Self {
            ended,
            data,
            slopes,
            factor,
            weights,
        })
    }

    /// Where the fit ended.
    pub fn ended(&self) -> &Ended {
        &self.ended
    }

    /// Deviations of ln R and ln L around the physics.
    pub fn misfit(&self) -> [f64; 2] {
        self.ended.misfit
    }

    /// ln R and ln L at places, R of all and then L of all, with their covariance `ahead_s` seconds after the last datum.
    /// Places of one frequency lie together.
    pub fn joint(&self, places: &[(f64, f64)], ahead_s: f64) -> (DVector<f64>, DMatrix<f64>) {
        let asked = self.asked(places, ahead_s);
        let prior = covariance(&asked.at, self.ended.misfit)
            + &asked.slopes * asked.slopes.transpose()
            + &asked.heat * asked.heat.transpose();
        let known = asked.cross.tr_mul(&self.factor.solve(&asked.cross));
        (asked.mean, prior - known)
    }

    /// R and L with their deviations at places, as [`Self::joint`] without what they have in common.
    pub fn at(&self, places: &[(f64, f64)], ahead_s: f64) -> Vec<Predicted> {
        let asked = self.asked(places, ahead_s);
        let whitened = self.factor.l_dirty().solve_lower_triangular(&asked.cross);
        let count = places.len();
        let sigma = |row: usize| {
            let misfit = self.ended.misfit[row / count];
            let prior =
                misfit.powi(2) + asked.slopes.row(row).norm_squared() + asked.heat[row].powi(2);
            let known = whitened
                .as_ref()
                .map_or(0.0, |w| w.column(row).norm_squared());
            (prior - known).max(0.0).sqrt()
        };
        (0..count)
            .map(|k| Predicted {
                r_ohm: asked.mean[k].exp(),
                l_h: asked.mean[count + k].exp(),
                r_sigma: sigma(k),
                l_sigma: sigma(count + k),
            })
            .collect()
    }

    fn asked(&self, places: &[(f64, f64)], ahead_s: f64) -> Asked {
        let at: Vec<Datum> = places
            .iter()
            .map(|&(f_hz, i_a)| place(f_hz, i_a, ahead_s))
            .collect();
        let slopes = derivatives(&self.ended.from, &self.ended.steps, &at, self.ended.used);
        let mut cross = &self.slopes * slopes.transpose();
        let here: Vec<Place> = self.data.iter().map(Datum::place).collect();
        for (n, there) in at.iter().map(Datum::place).enumerate() {
            for (m, seen) in here.iter().enumerate() {
                let correlation = seen.correlation(there);
                for (x, tau) in self.ended.misfit.iter().enumerate() {
                    cross[(x * here.len() + m, x * at.len() + n)] += tau * tau * correlation;
                }
            }
        }
        let expected = predicted(&self.ended.model(), &at) - &slopes * free(&self.ended);
        Asked {
            mean: expected + cross.tr_mul(&self.weights),
            heat: heat(&self.ended.model(), &at),
            slopes,
            cross,
            at,
        }
    }
}

/// What is asked for: places, and how they hang together with what is seen.
struct Asked {
    at: Vec<Datum>,
    mean: DVector<f64>,
    slopes: DMatrix<f64>,
    heat: DVector<f64>,
    /// Covariance of what is seen with what is asked for.
    cross: DMatrix<f64>,
}

fn free(ended: &Ended) -> DVector<f64> {
    DVector::from_fn(ended.used, |k, _| ended.steps[k])
}

/// Where the fit of a few data ends, from the pot of before where that still holds.
fn ended(few: &[Datum], start: Option<&Ended>) -> Option<Ended> {
    const FIRST: [f64; 2] = [0.01, 0.005];
    let ended = |fitted: &Fitted, misfit| Ended {
        from: fitted.from,
        steps: fitted.steps,
        used: fitted.used,
        misfit,
    };
    let again = start.and_then(|s| {
        let fitted = fit(few, (&s.from, s.steps), s.used, s.misfit, 4)?;
        // As many squares as data: it holds.
        (fitted.cost < few.len() as f64).then_some((fitted, s.misfit))
    });
    if let Some((fitted, misfit)) = again {
        let misfit = evident(few, &fitted, misfit).unwrap_or(misfit);
        return Some(ended(&fitted, misfit));
    }
    let mut fitted = fit_any(few, FIRST)?;
    let mut misfit = evident(few, &fitted, FIRST)?;
    if misfit[0] > MISFITS_R[0] || misfit[1] > MISFITS_L[0] {
        let least = [MISFITS_R[1], MISFITS_L[1]];
        if let Some(shifted) = fit_off_centre(few, &fitted, least) {
            fitted = shifted;
            misfit = evident(few, &fitted, least)?;
        }
    }
    let fitted = fit(few, (&fitted.from, fitted.steps), fitted.used, misfit, 6)?;
    Some(ended(&fitted, misfit))
}

fn place(f_hz: f64, i_a: f64, ahead_s: f64) -> Datum {
    Datum {
        f_hz,
        i_a,
        ln: [0.0; 2],
        variance: [0.0; 2],
        age_s: ahead_s,
    }
}

/// By how much ln R and ln L may have moved since each datum was seen, all by the same heat.
fn heat(model: &PotModel, data: &[Datum]) -> DVector<f64> {
    let hotter = PotModel {
        ln_s: model.ln_s + STEP_LN_S,
        ..*model
    };
    let mut all = (predicted(&hotter, data) - predicted(model, data)) / STEP_LN_S;
    let count = data.len();
    for k in 0..2 * count {
        let age_s = data[k % count].age_s.max(0.0);
        let moved = HEATING_PER_S * HEATING_ENDS_S * (1.0 - (-age_s / HEATING_ENDS_S).exp());
        all[k] *= moved;
    }
    all
}

/// At most [`LOOKED_AT`] data, evenly from all.
fn thinned(data: &[Datum]) -> Vec<Datum> {
    let every = data.len().div_ceil(LOOKED_AT).max(1);
    data.iter().copied().step_by(every).collect()
}

/// The misfits that the data speak for, one after the other for R and for L.
fn evident(data: &[Datum], fitted: &Fitted, begin: [f64; 2]) -> Option<[f64; 2]> {
    let slopes = derivatives(&fitted.from, &fitted.steps, data, fitted.used);
    let numbers = &slopes * slopes.transpose();
    let heat = heat(&fitted.model(), data);
    let numbers = numbers + &heat * heat.transpose();
    let steps = DVector::from_fn(fitted.used, |k, _| fitted.steps[k]);
    let left = seen(data) - (predicted(&fitted.model(), data) - slopes * steps);
    let evidence = |tau: [f64; 2]| {
        let factor = (covariance(data, tau) + &numbers).cholesky()?;
        let determinant: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
        Some(-0.5 * left.dot(&factor.solve(&left)) - determinant)
    };
    let mut tau = begin;
    for _ in 0..2 {
        for (x, choices) in [MISFITS_R, MISFITS_L].iter().enumerate() {
            let of = |choice: &f64| {
                let mut there = tau;
                there[x] = *choice;
                evidence(there).map(|e| (e, *choice))
            };
            let best = choices
                .iter()
                .filter_map(of)
                .max_by(|a, b| a.0.total_cmp(&b.0))?;
            tau[x] = best.1;
        }
    }
    Some(tau)
}
