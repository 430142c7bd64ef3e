//! A fitted pot with what it leaves: R and L with their deviations at any frequency and current.
//!
//! Linear around the fit, everything is normal: numbers of the pot with their prior, the misfit, heat since something
//! was seen, errors of measurement. What is seen conditions all of it at once.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::PotModel;
use crate::ended::{Ended, ended};
use crate::fit::{Datum, covariance, derivatives, predicted, seen};
use crate::misfit::Place;
use crate::parameters::{self, COUNT, Prior};

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

/// What is known of one pot.
#[derive(Clone, Debug)]
pub(crate) struct Knowledge {
    ended: Ended,
    data: Vec<Datum>,
    slopes: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    /// K⁻¹ (seen − expected).
    weights: DVector<f64>,
    /// ln of how likely all that was seen is, up to what is the same for every prior.
    evidence: f64,
}

impl Knowledge {
    /// From everything seen, at most some hundred data; `believed` is a known pot, `start` the pot of before. `None` where there
    /// is nothing, or the numbers are beyond a Cholesky factorisation.
    pub fn of(data: Vec<Datum>, believed: Option<&Prior>, start: Option<&Ended>) -> Option<Self> {
        if data.is_empty() {
            return None;
        }
        let ended = ended(&data, believed, start)?;
        Self::conditioned(ended, data)
    }

    /// What follows from where a fit ended and from what was seen.
    pub fn conditioned(ended: Ended, data: Vec<Datum>) -> Option<Self> {
        let slopes = derivatives(&ended.prior(), &ended.steps, &data, ended.used);
        let heat = heat(&ended.model(), &data);
        let all = covariance(&data, ended.misfit)
            + &slopes * slopes.transpose()
            + &heat * heat.transpose();
        let factor = all.cholesky()?;
        // Linear in the numbers, the prior's middle would show `predicted − slopes · steps`.
        let expected = predicted(&ended.model(), &data) - &slopes * free(&ended);
        let left = seen(&data) - expected;
        let weights = factor.solve(&left);
        let determinant: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
        Some(Self {
            ended,
            data,
            slopes,
            evidence: -0.5 * left.dot(&weights) - determinant,
            factor,
            weights,
        })
    }

    /// Where the fit ended.
    pub fn ended(&self) -> &Ended {
        &self.ended
    }

    /// ln of how likely all that was seen is under what was believed of the pot, but for a constant of the data.
    pub fn evidence(&self) -> f64 {
        self.evidence
    }

    /// Covariance of the numbers, as the lower triangle L of L Lᵀ in their units; `None` beyond a Cholesky factorisation.
    /// A number that was not free keeps its spread.
    pub fn factor_of_numbers(&self) -> Option<DMatrix<f64>> {
        let known = self.slopes.tr_mul(&self.factor.solve(&self.slopes));
        let mut steps = DMatrix::identity(COUNT, COUNT);
        let used = self.ended.used;
        let mut free = steps.view_mut((0, 0), (used, used));
        free -= known;
        let spread = self.ended.prior().spread;
        let columns = DMatrix::from_fn(COUNT, COUNT, |row, k| parameters::column(&spread, k)[row]);
        let all = &columns * steps * columns.transpose();
        Some(all.cholesky()?.unpack())
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
        let slopes = derivatives(&self.ended.prior(), &self.ended.steps, &at, self.ended.used);
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
pub(crate) fn heat(model: &PotModel, data: &[Datum]) -> DVector<f64> {
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
