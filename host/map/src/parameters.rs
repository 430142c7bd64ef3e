//! The numbers of a [`PotModel`] as a vector, in units in which each may be expected to move by about one, and what
//! is believed of them before anything was seen.

use crate::PotModel;

/// Numbers that are fitted.
pub(crate) const COUNT: usize = 7;

/// Of which the last one is the offset: without one the impedance does not know where it would go.
pub(crate) const CENTRED: usize = COUNT - 1;

pub(crate) type Vector = [f64; COUNT];

/// Deviation of each number around its beginning: metals of a class differ by these factors of α and s, hot and cold
/// included; the base's radius, its lift, the coil against the paper's, its winding, and how far off centre pots are put.
const SPREAD: Vector = [0.8, 0.4, 0.03, 0.006, 0.02, 0.03, 0.02];

/// Where the gap's table and the metals end.
const LEAST: Vector = [5.3, -16.5, 0.025, -0.002, -0.2, 0.0, 0.0];
const MOST: Vector = [13.9, -9.0, 0.13, 0.065, 0.2, 0.5, 0.06];

fn raw(model: &PotModel) -> Vector {
    [
        model.ln_alpha,
        model.ln_s,
        model.radius_m,
        model.lift_m,
        model.ln_turns,
        model.winding_r_ohm,
        model.offset_m,
    ]
}

/// The model that is `steps` spreads away from `from`, within what there is.
pub(crate) fn moved(from: &PotModel, steps: &Vector) -> PotModel {
    let from = raw(from);
    let at = |k: usize| (from[k] + steps[k] * SPREAD[k]).clamp(LEAST[k], MOST[k]);
    PotModel {
        ln_alpha: at(0),
        ln_s: at(1),
        radius_m: at(2),
        lift_m: at(3),
        ln_turns: at(4),
        winding_r_ohm: at(5),
        offset_m: at(6),
    }
}

/// How many spreads `model` is away from `from`.
pub(crate) fn steps(from: &PotModel, model: &PotModel) -> Vector {
    let (from, to) = (raw(from), raw(model));
    std::array::from_fn(|k| (to[k] - from[k]) / SPREAD[k])
}

/// Pots to begin with: α in A/m, s in √(H/S), radius in metre.
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

/// Winding and leads of a hob's coil in ohm.
const WINDING_R_OHM: f64 = 0.1;

/// The pots that a fit begins with.
pub(crate) fn classes() -> impl Iterator<Item = PotModel> {
    CLASSES.into_iter().map(|(alpha, s, radius_m)| PotModel {
        ln_alpha: alpha.ln(),
        ln_s: s.ln(),
        radius_m,
        winding_r_ohm: WINDING_R_OHM,
        ..PotModel::PAPER
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_models_are_the_same_thing() {
        for class in classes() {
            let there = [0.5, -0.3, 0.4, 0.7, -1.0, 0.9, 1.2];
            let back = steps(&class, &moved(&class, &there));
            let clamped = class.ln_alpha > 13.0;
            for k in usize::from(clamped)..COUNT {
                assert!((back[k] - there[k]).abs() < 1e-9, "{k}: {back:?}");
            }
        }
        let far = moved(&PotModel::PAPER, &[1e9; COUNT]);
        assert!((far.radius_m, far.lift_m) == (0.13, 0.065));
    }
}
