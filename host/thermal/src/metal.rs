//! Effect of heat on a pot's metal.

use serde::{Deserialize, Serialize};

/// Law of resistivity times saturation over temperature, both relative to their values at the start.
///
/// The coefficients are those of a class of metals. Those of a pot's own alloy are unknown, see [`MetalLaw::SPREAD`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetalLaw {
    /// Slope of the resistivity in 1/K, relative to that at the start.
    pub resistivity_per_k: f64,
    /// Curie point less the start's temperature in kelvin; `None` for a metal that is not ferromagnetic.
    pub curie_rise_k: Option<f64>,
    /// ln α of the class ([`PotModel`](ihd_map::PotModel)) at room temperature.
    pub ln_alpha: f64,
    /// ln s of the class at room temperature.
    pub ln_s: f64,
    /// Effect of heat relative to the class: 1 for an alloy that is not known.
    pub effect: f64,
}

/// Largest deviation in kelvin: where the slope is zero, both sides of the turn are this far apart.
const MAX_SIGMA_K: f64 = 60.0;

/// Standard deviation in kelvin of a pot's temperature when it is put on: out of a cold or a warm room (docs/map.md says what a hot
/// one shows). The larger one is that of a pot that is heated already when its first values come.
const START_SIGMA_K: f64 = 15.0;
const HEATED_START_SIGMA_K: f64 = 80.0;

/// Range of rises in kelvin: metals on a hob are neither frozen nor molten.
const COLDEST_K: f64 = -200.0;
const HOTTEST_K: f64 = 1000.0;

impl MetalLaw {
    /// Ferritic stainless steel (1.4016: 0.60 µΩm at 20 °C, 0.66 at 100 °C in data sheets of mills; Curie point 680 °C).
    pub const FERRITIC: Self = Self {
        resistivity_per_k: 1.1e-3,
        curie_rise_k: Some(660.0),
        ln_alpha: 7.313,
        ln_s: -11.258,
        effect: 1.0,
    };

    /// Grey cast iron (EN 1561: 0.70 to 0.77 µΩm; +0.19 %/K).
    pub const CAST_IRON: Self = Self {
        resistivity_per_k: 1.9e-3,
        curie_rise_k: Some(660.0),
        ln_alpha: 8.613,
        ln_s: -11.074,
        effect: 1.0,
    };

    /// Classes that a hob can heat.
    pub const ALL: [Self; 2] = [Self::FERRITIC, Self::CAST_IRON];

    /// Relative standard deviation of the effect of heat within a class: steels differ by as much in the slope of their
    /// resistivity.
    pub const SPREAD: f64 = 0.12;

    /// Change of ln s by a rise in kelvin, and its slope in 1/K. s² ∝ resistivity · saturation, and the saturation falls as
    /// 1 − (rise/Curie rise)², so that the slope changes sign near 200 K.
    pub fn ln_s_change(&self, rise_k: f64) -> (f64, f64) {
        let rise_k = rise_k.clamp(COLDEST_K, HOTTEST_K);
        let resistivity = (1.0 + self.resistivity_per_k * rise_k).max(0.1);
        let mut change = 0.5 * resistivity.ln();
        let mut slope = 0.5 * self.resistivity_per_k / resistivity;
        if let Some(curie_k) = self.curie_rise_k {
            let x = (rise_k.max(0.0) / curie_k).min(0.95);
            let left = 1.0 - x * x;
            change += 0.5 * left.ln();
            slope -= x / (curie_k * left);
        }
        (self.effect * change, self.effect * slope)
    }

    /// The same class with another effect of heat.
    pub fn with_effect(self, effect: f64) -> Self {
        Self { effect, ..self }
    }

    /// Relative standard deviation if the class is unknown, too: cast iron changes 1.7 times as much as ferritic steel.
    pub const CLASS_SPREAD: f64 = 0.5;

    /// Standard deviation of a rise in kelvin by an unknown alloy, whose effect has the relative deviation `spread`. Near the turn
    /// the same R and L belong to a wide range of rises.
    pub fn alloy_sigma_k(&self, rise_k: f64, spread: f64) -> f64 {
        let (change, slope) = self.ln_s_change(rise_k);
        (spread * (change / slope).abs()).min(MAX_SIGMA_K)
    }

    /// Standard deviation of a rise in kelvin by the unknown temperature at the start. The law counts from 20 °C; on a warmer pot heat
    /// acts less, and by less than nothing beyond the turn.
    pub fn start_sigma_k(&self, rise_k: f64, is_heated_already: bool) -> f64 {
        let (change, slope) = self.ln_s_change(rise_k);
        let by_kelvin = ((slope - self.ln_s_change(0.0).1) / slope).abs();
        if !is_heated_already {
            return (START_SIGMA_K * by_kelvin).min(MAX_SIGMA_K);
        }
        // Rise with the same effect of a pot that was as hot at the start, if there is one.
        let hot_change = change + self.ln_s_change(HEATED_START_SIGMA_K).0;
        let hot_k = self.rise_with_change_k(hot_change, rise_k > self.turning_rise_k());
        let off_k = (hot_k - HEATED_START_SIGMA_K - rise_k).abs();
        off_k.max(HEATED_START_SIGMA_K * by_kelvin).min(MAX_SIGMA_K)
    }

    /// Rise in kelvin at which R and L stop rising and begin to fall; infinite if they never do.
    pub fn turning_rise_k(&self) -> f64 {
        // d ln ρ = −d ln B: a/(1 + a t) = 2t/(c² − t²), the root of 3a t² + 2t − a c² = 0.
        let a = self.resistivity_per_k;
        self.curie_rise_k.map_or(f64::INFINITY, |c| {
            ((1.0 + 3.0 * a * a * c * c).sqrt() - 1.0) / (3.0 * a)
        })
    }

    /// Rise in kelvin at which ln s has changed by `change`: below the turn, or beyond it. At the turn if it never changes by as much.
    pub fn rise_with_change_k(&self, change: f64, beyond: bool) -> f64 {
        let turn_k = self.turning_rise_k();
        // Both sides are monotone, so that bisection finds it.
        let (mut low, mut high) = match beyond {
            true => (turn_k, turn_k + 400.0),
            false => (COLDEST_K, turn_k),
        };
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if (self.ln_s_change(middle).0 > change) == beyond {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_change_is_on_both_sides_of_the_turn() {
        for metal in MetalLaw::ALL {
            for rise_k in [-30.0, 120.0, 180.0, 320.0] {
                let (change, turn_k) = (metal.ln_s_change(rise_k).0, metal.turning_rise_k());
                let sides = [false, true].map(|beyond| metal.rise_with_change_k(change, beyond));
                assert!(sides[0] < turn_k && turn_k < sides[1], "{sides:?}");
                assert!(sides.iter().any(|k| (k - rise_k).abs() < 1e-6), "{sides:?}");
                for side_k in sides {
                    assert!((metal.ln_s_change(side_k).0 - change).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn the_slope_is_the_derivative_and_turns_where_it_says() {
        for law in MetalLaw::ALL {
            for rise_k in [-10.0, 1.0, 80.0, 300.0] {
                let d = 1e-3;
                let numeric =
                    (law.ln_s_change(rise_k + d).0 - law.ln_s_change(rise_k - d).0) / (2.0 * d);
                assert!((numeric - law.ln_s_change(rise_k).1).abs() < 1e-9);
            }
            let turn_k = law.turning_rise_k();
            assert!((150.0..350.0).contains(&turn_k), "{turn_k}");
            assert!(law.ln_s_change(turn_k).1.abs() < 1e-9);
        }
    }

    /// Comparison with the simulator's metals, which are written independently.
    #[test]
    fn classes_are_the_simulators_metals() {
        use ihd_sim::pot::PotBase;
        for (law, base) in MetalLaw::ALL
            .iter()
            .zip([PotBase::Ferritic, PotBase::CastIron])
        {
            for rise_k in [30.0, 130.0, 300.0] {
                let expected = 0.5 * base.heat_factor(20.0 + rise_k).ln();
                assert!((law.ln_s_change(rise_k).0 - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_warm_start_is_within_its_deviation() {
        for law in MetalLaw::ALL {
            for (start_c, heated) in [(35.0, false), (60.0, true), (100.0, true)] {
                let start_k = start_c - 20.0;
                for rise_k in [10.0, 40.0, 80.0] {
                    let [from, here] = [start_k, start_k + rise_k].map(|k| law.ln_s_change(k).0);
                    let found_k = law.rise_with_change_k(here - from, false);
                    let sigma_k = law.start_sigma_k(found_k, heated);
                    let z = (rise_k - found_k).abs() / sigma_k;
                    let most = if heated { 1.001 } else { 1.7 };
                    assert!(z < most, "{start_c} °C, {rise_k} K: {found_k} ± {sigma_k}");
                }
            }
            // Cold pots pay little for it where most of the cooking is.
            assert!(law.start_sigma_k(40.0, false) < 4.5);
        }
    }
}
