//! Numbers of a [`PotModel`] as a vector, in units of their expected spread, and the prior on them.

use ihd_shared::hob::TURNS_RATIO;
use ihd_shared::hob::WINDING_R_OHM;
use serde::{Deserialize, Serialize};

use crate::PotModel;
use crate::pot_model::{Sensitivities, Sensitivity};

/// Number of parameters.
pub(crate) const COUNT: usize = 7;

/// Number of parameters of a centred pot. The last one is the offset, whose derivative is zero for a centred pot.
pub(crate) const CENTRED: usize = COUNT - 1;

pub(crate) type Vector = [f64; COUNT];

/// Prior deviation of each number: α and s within a class of metals, hot and cold included; the base's radius, its lift,
/// turns against the board's coil, its winding, and the offset.
pub(crate) const SPREAD: Vector = [0.8, 0.4, 0.03, 0.006, 0.02, 0.03, 0.02];

/// Limits of the gap's table and of metals.
const LOWER_LIMITS: Vector = [5.3, -16.5, 0.025, -0.002, -0.2, 0.0, 0.0];
const UPPER_LIMITS: Vector = [13.9, -9.0, 0.13, 0.065, 0.2, 0.5, 0.06];

/// Number of leading parameters that are the pot's own, α, s and radius; the others depend on place and coil.
pub(crate) const OF_POT: usize = 3;

/// Prior covariance of a pot's own numbers as the lower triangle L of L Lᵀ, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PotSpread(pub [f64; OF_POT * (OF_POT + 1) / 2]);

impl Default for PotSpread {
    /// Spread of any pot of a class.
    fn default() -> Self {
        Self([SPREAD[0], 0.0, SPREAD[1], 0.0, 0.0, SPREAD[2]])
    }
}

impl PotSpread {
    /// Row `k`, up to its diagonal.
    fn row(&self, k: usize) -> &[f64] {
        &self.0[k * (k + 1) / 2..][..=k]
    }

    /// Returns `true` if it is the spread of any pot, which is not stored.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Returns `true` if it is finite and within the range of priors.
    pub fn is_sound(&self) -> bool {
        (0..OF_POT).all(|k| {
            let row = self.row(k);
            let within = row.iter().all(|x| x.abs() <= 2.0 * SPREAD[k]);
            within && row[k] >= 1e-6 * SPREAD[k]
        })
    }
}

/// Prior on a pot: its mean and the spread of its own numbers. The spread of the other numbers is the same for all
/// pots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prior {
    pub from: PotModel,
    pub spread: PotSpread,
}

impl From<PotModel> for Prior {
    /// Prior of any pot of this class.
    fn from(from: PotModel) -> Self {
        Self {
            from,
            spread: PotSpread::default(),
        }
    }
}

pub(crate) fn raw(model: &PotModel) -> Vector {
    [
        model.ln_alpha,
        model.ln_s,
        model.radius_m,
        model.lift_m,
        model.ln_turns - TURNS_RATIO.ln(),
        model.winding_r_ohm,
        model.offset_m,
    ]
}

/// Position of ln s.
pub(crate) const LN_S: usize = 1;

/// Changes of R and L by each number, in the order of [`raw`].
pub(crate) fn of_numbers(by: &Sensitivities) -> [Sensitivity; COUNT] {
    [
        by.ln_alpha,
        by.ln_s,
        by.radius,
        by.lift,
        by.ln_turns,
        by.winding,
        by.offset,
    ]
}

/// Model with each number clamped to its range.
pub(crate) fn clamped(numbers: &Vector) -> PotModel {
    let at = |k: usize| numbers[k].clamp(LOWER_LIMITS[k], UPPER_LIMITS[k]);
    PotModel {
        ln_alpha: at(0),
        ln_s: at(1),
        radius_m: at(2),
        lift_m: at(3),
        ln_turns: at(4) + TURNS_RATIO.ln(),
        winding_r_ohm: at(5),
        offset_m: at(6),
    }
}

/// Returns `true` if each number is finite and in its range.
pub(crate) fn is_sound(model: &PotModel) -> bool {
    let ranges = LOWER_LIMITS.iter().zip(&UPPER_LIMITS);
    let mut all = raw(model).into_iter().zip(ranges);
    all.all(|(x, (least, most))| (*least..=*most).contains(&x))
}

/// Change of each number by one spread of step `k`.
pub(crate) fn column(spread: &PotSpread, k: usize) -> Vector {
    let mut all = [0.0; COUNT];
    if k < OF_POT {
        (k..OF_POT).for_each(|n| all[n] = spread.row(n)[k]);
    } else {
        all[k] = SPREAD[k];
    }
    all
}

/// Model that is `steps` spreads away from the prior's mean, clamped to the ranges.
pub(crate) fn moved(prior: &Prior, steps: &Vector) -> PotModel {
    let from = raw(&prior.from);
    let by = |k: usize| {
        if k < OF_POT {
            let row = prior.spread.row(k).iter().zip(steps);
            row.map(|(x, step)| x * step).sum()
        } else {
            steps[k] * SPREAD[k]
        }
    };
    clamped(&std::array::from_fn(|k| from[k] + by(k)))
}

/// Distance of `model` from the prior's mean, in spreads.
pub(crate) fn steps(prior: &Prior, model: &PotModel) -> Vector {
    let (from, to) = (raw(&prior.from), raw(model));
    let mut steps = [0.0; COUNT];
    for k in 0..COUNT {
        let left = to[k] - from[k];
        steps[k] = if k < OF_POT {
            let row = prior.spread.row(k);
            let known: f64 = row[..k].iter().zip(&steps).map(|(x, step)| x * step).sum();
            (left - known) / row[k]
        } else {
            left / SPREAD[k]
        };
    }
    steps
}

/// Classes of pots with which a fit begins: α in A/m, s in √(H/S), radius in metre.
const CLASSES: [(f64, f64, f64); 5] = [
    // Ferritic steel, full and small.
    (1_500.0, 1.29e-5, 0.1),
    (1_500.0, 1.29e-5, 0.07),
    // Grey cast iron.
    (5_500.0, 1.55e-5, 0.1),
    // 304 and aluminium, which do not saturate.
    (1e6, 9.6e-7, 0.1),
    (1e6, 1.9e-7, 0.1),
];

/// Pots with which a fit begins.
pub(crate) fn classes() -> impl Iterator<Item = PotModel> {
    CLASSES.into_iter().map(|(alpha, s, radius_m)| PotModel {
        ln_alpha: alpha.ln(),
        ln_s: s.ln(),
        radius_m,
        ln_turns: TURNS_RATIO.ln(),
        winding_r_ohm: WINDING_R_OHM,
        ..PotModel::PAPER
    })
}

/// Same pot with default values for coil and place.
pub(crate) fn anywhere(pot: &PotModel) -> PotModel {
    PotModel {
        lift_m: 0.0,
        offset_m: 0.0,
        ln_turns: TURNS_RATIO.ln(),
        winding_r_ohm: WINDING_R_OHM,
        ..*pot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_models_are_the_same_thing() {
        for class in classes() {
            let there = [0.5, -0.3, 0.4, 0.7, -1.0, 0.9, 1.2];
            let class = Prior::from(class);
            let back = steps(&class, &moved(&class, &there));
            let clamped = class.from.ln_alpha > 13.0;
            for k in usize::from(clamped)..COUNT {
                assert!((back[k] - there[k]).abs() < 1e-9, "{k}: {back:?}");
            }
        }
        let far = moved(&PotModel::PAPER.into(), &[1e9; COUNT]);
        assert!((far.radius_m, far.lift_m) == (0.13, 0.065));
    }

    #[test]
    fn numbers_of_a_known_pot_move_together() {
        let known = Prior {
            from: PotModel::PAPER,
            spread: PotSpread([0.1, -0.05, 0.02, 0.001, 0.002, 0.003]),
        };
        let there = [1.0, 2.0, -1.0, 0.5, 0.1, 4.0, 0.3];
        let model = moved(&known, &there);
        assert!((model.ln_s - known.from.ln_s - (-0.05 + 2.0 * 0.02)).abs() < 1e-12);
        assert!((model.radius_m - known.from.radius_m - (0.001 + 0.004 - 0.003)).abs() < 1e-12);
        for (back, there) in steps(&known, &model).into_iter().zip(there) {
            assert!((back - there).abs() < 1e-9);
        }
        assert_eq!(column(&known.spread, 0)[..3], [0.1, -0.05, 0.001]);
        let wide = PotSpread([9.0, 0.0, 0.1, 0.0, 0.0, 0.01]);
        assert!(known.spread.is_sound() && !wide.is_sound());
        assert!(!PotSpread([f64::NAN; 6]).is_sound() && !PotSpread([0.0; 6]).is_sound());
    }
}
