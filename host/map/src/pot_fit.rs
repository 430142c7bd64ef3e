//! Fit of a pot: chooses start, class and misfit of the physics, and returns the fitted numbers.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::fit::{
    Datum, Descent, Linearised, MAX_STEPS, covariance, fit, fit_any, fit_off_centre, log_evidence,
    measured,
};
use crate::parameters::{self, CENTRED, COUNT, PotSpread, Prior, Vector};

/// Candidates for the deviations of ln R and ln L around the physics, from which the evidence chooses. The smallest ones are
/// the error of the describing function after a fit (docs/map.md).
const MISFITS_R: [f64; 7] = [0.004, 0.008, 0.016, 0.03, 0.06, 0.12, 0.24];
const MISFITS_L: [f64; 7] = [0.002, 0.004, 0.008, 0.016, 0.03, 0.06, 0.12];

/// Most data that the fit uses: more determine seven numbers no better.
const MAX_DATA: usize = 48;

/// Result of a fit. Together with the measured data it determines every prediction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PotFit {
    /// Mean of the prior.
    from: PotModel,
    /// Prior covariance of the pot's own numbers.
    #[serde(default, skip_serializing_if = "PotSpread::is_default")]
    spread: PotSpread,
    /// Fitted numbers, in spreads from the prior's mean.
    pub(crate) steps: Vector,
    /// Number of free parameters.
    pub(crate) used: usize,
    /// Deviations of ln R and ln L around the physics.
    pub(crate) misfit: [f64; 2],
}

impl PotFit {
    pub fn is_sound(&self) -> bool {
        let finite = self.steps.iter().chain(&self.misfit).all(|x| x.is_finite());
        let middle = parameters::raw(&self.from);
        finite
            && middle.iter().all(|x| x.is_finite())
            && self.spread.is_sound()
            && self.used <= COUNT
            && self.misfit.iter().all(|x| *x > 0.0)
    }

    fn from_descent(fitted: &Descent, misfit: [f64; 2]) -> Self {
        Self {
            from: fitted.prior.from,
            spread: fitted.prior.spread,
            steps: fitted.steps,
            used: fitted.used,
            misfit,
        }
    }

    /// Prior that the fit began with.
    pub fn prior(&self) -> Prior {
        Prior {
            from: self.from,
            spread: self.spread,
        }
    }

    /// Fitted pot.
    pub fn model(&self) -> PotModel {
        parameters::moved(&self.prior(), &self.steps)
    }
}

/// Misfits with which a fit begins.
pub(crate) const FIRST_MISFIT: [f64; 2] = [0.01, 0.005];

/// Fits a pot to data: from the last fit if that still holds, else from the prior of a known pot, else from all classes of pots.
pub(crate) fn fit_pot(
    data: &[Datum],
    believed: Option<&Prior>,
    start: Option<&PotFit>,
) -> Option<PotFit> {
    let few = &thinned(data);
    let again = start.and_then(|s| {
        let fitted = fit(few, (&s.prior(), s.steps), s.used, s.misfit, 4)?;
        // The squares do not exceed the number of data: the last fit still holds.
        (fitted.cost < few.len() as f64).then_some((fitted, s.misfit))
    });
    if let Some((fitted, misfit)) = again {
        let misfit = best_misfit(few, &fitted, misfit).unwrap_or(misfit);
        return Some(PotFit::from_descent(&fitted, misfit));
    }
    let mut fitted = match believed {
        Some(prior) => fit(few, (prior, [0.0; COUNT]), CENTRED, FIRST_MISFIT, MAX_STEPS)?,
        None => fit_any(few, FIRST_MISFIT)?,
    };
    let mut misfit = best_misfit(few, &fitted, FIRST_MISFIT)?;
    if misfit[0] > MISFITS_R[0] || misfit[1] > MISFITS_L[0] {
        let least = [MISFITS_R[1], MISFITS_L[1]];
        if let Some(shifted) = fit_off_centre(few, &fitted, least) {
            fitted = shifted;
            misfit = best_misfit(few, &fitted, least)?;
        }
    }
    let fitted = fit(few, (&fitted.prior, fitted.steps), fitted.used, misfit, 6)?;
    Some(PotFit::from_descent(&fitted, misfit))
}

/// At most [`MAX_DATA`] data, taken evenly from all.
fn thinned(data: &[Datum]) -> Vec<Datum> {
    let every = data.len().div_ceil(MAX_DATA).max(1);
    data.iter().copied().step_by(every).collect()
}

/// Misfits of R and L with the largest evidence, chosen in turn.
fn best_misfit(data: &[Datum], fitted: &Descent, begin: [f64; 2]) -> Option<[f64; 2]> {
    let Linearised { ln, slopes, heat } =
        Linearised::at((&fitted.prior, &fitted.steps), data, fitted.used);
    let numbers = &slopes * slopes.transpose() + heat.covariance();
    let steps = DVector::from_fn(fitted.used, |k, _| fitted.steps[k]);
    let left = measured(data) - (ln - slopes * steps);
    let evidence = |tau: [f64; 2]| {
        let factor = (covariance(data, tau) + &numbers).cholesky()?;
        Some(log_evidence(&factor, &left).0)
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
