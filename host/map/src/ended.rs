//! Where the fit of a pot ends, and how large the misfit around it is.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::fit::{
    Datum, Fitted, MOST_STEPS, covariance, derivatives, fit, fit_any, fit_off_centre, predicted,
    seen,
};
use crate::knowledge::heat;
use crate::parameters::{self, CENTRED, COUNT, PotSpread, Prior, Vector};

/// Deviations of ln R and ln L that the misfit may have, of which the evidence chooses. The least ones are what the
/// describing function is off by once a pot was fitted to it (docs/map.md).
const MISFITS_R: [f64; 7] = [0.004, 0.008, 0.016, 0.03, 0.06, 0.12, 0.24];
const MISFITS_L: [f64; 7] = [0.002, 0.004, 0.008, 0.016, 0.03, 0.06, 0.12];

/// Misfits from which the physics is said not to describe the pot: twice what harmonics of the current make.
pub const UNDESCRIBED: [f64; 2] = [0.025, 0.012];

/// Data that the fit itself looks at: more say nothing new of seven numbers.
const LOOKED_AT: usize = 48;

/// Where a fit ended, which all that is known follows from together with what was seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Ended {
    /// The middle of the prior.
    from: PotModel,
    /// How far the pot's own numbers may be from there.
    #[serde(default, skip_serializing_if = "PotSpread::is_default")]
    spread: PotSpread,
    /// The pot, in spreads from there.
    pub(crate) steps: Vector,
    /// How many of its numbers were free.
    pub(crate) used: usize,
    /// Deviations of ln R and ln L around the physics.
    pub(crate) misfit: [f64; 2],
}

impl Ended {
    pub fn is_sound(&self) -> bool {
        let finite = self.steps.iter().chain(&self.misfit).all(|x| x.is_finite());
        let middle = parameters::raw(&self.from);
        finite
            && middle.iter().all(|x| x.is_finite())
            && self.spread.is_sound()
            && self.used <= COUNT
            && self.misfit.iter().all(|x| *x > 0.0)
    }

    fn of(fitted: &Fitted, misfit: [f64; 2]) -> Self {
        Self {
            from: fitted.prior.from,
            spread: fitted.prior.spread,
            steps: fitted.steps,
            used: fitted.used,
            misfit,
        }
    }

    /// What was believed before.
    pub fn prior(&self) -> Prior {
        Prior {
            from: self.from,
            spread: self.spread,
        }
    }

    /// The pot.
    pub fn model(&self) -> PotModel {
        parameters::moved(&self.prior(), &self.steps)
    }
}

/// Misfits at which a fit begins.
pub(crate) const FIRST: [f64; 2] = [0.01, 0.005];

/// Where the fit of data ends: from the pot of before where that still holds, else from what is believed of a known pot, or of any.
pub(crate) fn ended(
    data: &[Datum],
    believed: Option<&Prior>,
    start: Option<&Ended>,
) -> Option<Ended> {
    let few = &thinned(data);
    let again = start.and_then(|s| {
        let fitted = fit(few, (&s.prior(), s.steps), s.used, s.misfit, 4)?;
        // As many squares as data: it holds.
        (fitted.cost < few.len() as f64).then_some((fitted, s.misfit))
    });
    if let Some((fitted, misfit)) = again {
        let misfit = evident(few, &fitted, misfit).unwrap_or(misfit);
        return Some(Ended::of(&fitted, misfit));
    }
    let mut fitted = match believed {
        Some(prior) => fit(few, (prior, [0.0; COUNT]), CENTRED, FIRST, MOST_STEPS)?,
        None => fit_any(few, FIRST)?,
    };
    let mut misfit = evident(few, &fitted, FIRST)?;
    if misfit[0] > MISFITS_R[0] || misfit[1] > MISFITS_L[0] {
        let least = [MISFITS_R[1], MISFITS_L[1]];
        if let Some(shifted) = fit_off_centre(few, &fitted, least) {
            fitted = shifted;
            misfit = evident(few, &fitted, least)?;
        }
    }
    let fitted = fit(few, (&fitted.prior, fitted.steps), fitted.used, misfit, 6)?;
    Some(Ended::of(&fitted, misfit))
}

/// At most [`LOOKED_AT`] data, evenly from all.
fn thinned(data: &[Datum]) -> Vec<Datum> {
    let every = data.len().div_ceil(LOOKED_AT).max(1);
    data.iter().copied().step_by(every).collect()
}

/// The misfits that the data speak for, one after the other for R and for L.
fn evident(data: &[Datum], fitted: &Fitted, begin: [f64; 2]) -> Option<[f64; 2]> {
    let slopes = derivatives(&fitted.prior, &fitted.steps, data, fitted.used);
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
