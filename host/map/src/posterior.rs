//! Predictions from a fitted pot: R and L with their deviations at any frequency and current.
//!
//! Linearised around the fit, all quantities are normal: numbers of the pot with their prior, misfit, heating since a
//! measurement, and errors of measurement. Predictions are conditioned on all measured data at once.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::fit::{Datum, Heat, Linearised, covariance, log_evidence, measured};
use crate::misfit::MapPoint;
use crate::parameters::{self, COUNT, Prior};
use crate::pot_fit::{PotFit, fit_pot};

/// Predicted R and L at one place, with deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RlPrediction {
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Relative standard deviation of R.
    pub r_sigma: f64,
    /// Relative standard deviation of L.
    pub l_sigma: f64,
}

/// Fit of one pot, conditioned on the measured data.
#[derive(Clone, Debug)]
pub(crate) struct Posterior {
    fit: PotFit,
    data: Vec<Datum>,
    slopes: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    /// K⁻¹ (measured − expected).
    weights: DVector<f64>,
    /// ln of the data's likelihood, up to a term that is the same for every prior.
    evidence: f64,
}

impl Posterior {
    /// Fits some hundred data at most; `believed` is the prior of a known pot, `start` the last fit. `None` if there are no data
    /// or a Cholesky factorisation fails.
    pub fn from_data(
        data: Vec<Datum>,
        believed: Option<&Prior>,
        start: Option<&PotFit>,
    ) -> Option<Self> {
        if data.is_empty() {
            return None;
        }
        let fit = fit_pot(&data, believed, start)?;
        Self::conditioned(fit, data)
    }

    /// Conditions an existing fit on data; `None` if a Cholesky factorisation fails.
    pub fn conditioned(fit: PotFit, data: Vec<Datum>) -> Option<Self> {
        let Linearised { ln, slopes, heat } =
            Linearised::at((&fit.prior(), &fit.steps), &data, fit.used);
        let numbers = &slopes * slopes.transpose();
        let all = covariance(&data, fit.misfit) + numbers + heat.covariance();
        let factor = all.cholesky()?;
        // The model is linear in the numbers: at the prior's mean it would give `predicted − slopes · steps`.
        let expected = ln - &slopes * free(&fit);
        let left = measured(&data) - expected;
        let (evidence, weights) = log_evidence(&factor, &left);
        Some(Self {
            fit,
            data,
            slopes,
            evidence,
            factor,
            weights,
        })
    }

    /// Underlying fit.
    pub fn fit(&self) -> &PotFit {
        &self.fit
    }

    /// ln of the data's likelihood under the prior, up to a constant of the data.
    pub fn evidence(&self) -> f64 {
        self.evidence
    }

    /// Covariance of the numbers as the lower triangle L of L Lᵀ in their units; `None` if a Cholesky factorisation fails.
    /// A number that was not free keeps its prior spread.
    pub fn factor_of_numbers(&self) -> Option<DMatrix<f64>> {
        let known = self.slopes.tr_mul(&self.factor.solve(&self.slopes));
        let mut steps = DMatrix::identity(COUNT, COUNT);
        let used = self.fit.used;
        let mut free = steps.view_mut((0, 0), (used, used));
        free -= known;
        let spread = self.fit.prior().spread;
        let columns = DMatrix::from_fn(COUNT, COUNT, |row, k| parameters::column(&spread, k)[row]);
        let all = &columns * steps * columns.transpose();
        Some(all.cholesky()?.unpack())
    }

    /// Deviations of ln R and ln L around the physics.
    pub fn misfit(&self) -> [f64; 2] {
        self.fit.misfit
    }

    /// ln R and ln L at places (R of all, then L of all) with their covariance `ahead_s` seconds after the last datum.
    /// Places of one frequency must be adjacent.
    pub fn joint(&self, places: &[(f64, f64)], ahead_s: f64) -> (DVector<f64>, DMatrix<f64>) {
        let predicted = self.predict(places, ahead_s);
        let prior = covariance(&predicted.at, self.fit.misfit)
            + &predicted.slopes * predicted.slopes.transpose()
            + predicted.heat.covariance();
        let known = predicted.cross.tr_mul(&self.factor.solve(&predicted.cross));
        (predicted.mean, prior - known)
    }

    /// R and L at places with deviations: [`Self::joint`] without the correlations.
    pub fn at(&self, places: &[(f64, f64)], ahead_s: f64) -> Vec<RlPrediction> {
        let predicted = self.predict(places, ahead_s);
        let whitened = self
            .factor
            .l_dirty()
            .solve_lower_triangular(&predicted.cross);
        let count = places.len();
        let sigma = |row: usize| {
            let misfit = self.fit.misfit[row / count];
            let prior = misfit.powi(2)
                + predicted.slopes.row(row).norm_squared()
                + predicted.heat.variance(row);
            let known = whitened
                .as_ref()
                .map_or(0.0, |w| w.column(row).norm_squared());
            (prior - known).max(0.0).sqrt()
        };
        (0..count)
            .map(|k| RlPrediction {
                r_ohm: predicted.mean[k].exp(),
                l_h: predicted.mean[count + k].exp(),
                r_sigma: sigma(k),
                l_sigma: sigma(count + k),
            })
            .collect()
    }

    fn predict(&self, places: &[(f64, f64)], ahead_s: f64) -> JointPrediction {
        let at: Vec<Datum> = places
            .iter()
            .map(|&(f_hz, i_a)| place(f_hz, i_a, ahead_s))
            .collect();
        let fit = &self.fit;
        let Linearised { ln, slopes, heat } =
            Linearised::at((&fit.prior(), &fit.steps), &at, fit.used);
        let mut cross = &self.slopes * slopes.transpose();
        let here: Vec<MapPoint> = self.data.iter().map(Datum::place).collect();
        for (n, place) in at.iter().map(Datum::place).enumerate() {
            for (m, seen) in here.iter().enumerate() {
                let correlation = seen.correlation(place);
                for (x, tau) in fit.misfit.iter().enumerate() {
                    cross[(x * here.len() + m, x * at.len() + n)] += tau * tau * correlation;
                }
            }
        }
        let expected = ln - &slopes * free(fit);
        JointPrediction {
            mean: expected + cross.tr_mul(&self.weights),
            heat,
            slopes,
            cross,
            at,
        }
    }
}

/// Places of a prediction and their correlation with the measured data.
struct JointPrediction {
    at: Vec<Datum>,
    mean: DVector<f64>,
    slopes: DMatrix<f64>,
    heat: Heat,
    /// Covariance of measured data and predictions.
    cross: DMatrix<f64>,
}

fn free(fit: &PotFit) -> DVector<f64> {
    DVector::from_fn(fit.used, |k, _| fit.steps[k])
}

fn place(f_hz: f64, i_a: f64, ahead_s: f64) -> Datum {
    Datum {
        f_hz,
        i_a,
        ln: [0.0; 2],
        variance: [0.0; 2],
        level: [0.0; 2],
        common: [0.0; 2],
        age_s: -ahead_s.max(0.0),
    }
}
