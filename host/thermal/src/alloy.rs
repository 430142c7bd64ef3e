//! Effect of heat on the metals of pots that were seen before. Steels of one class differ; water that boils says how hot the base is,
//! and so by how much.

use ihd_signal::noise::median;
use serde::{Deserialize, Serialize};

use crate::metal::MetalLaw;
use crate::placement::PlacedPot;

/// Pots that are remembered.
const MAX_POTS: usize = 16;

/// Boils of a pot that are remembered.
const MAX_BOILS: usize = 5;

/// Rise in kelvin at which water boils that was put on at 20 °C.
const BOIL_K: f64 = 80.0;

/// Relative standard deviation of the effect by one boil: 3.5 K of the water's temperature at the start and of the boiling point,
/// 3 K of the curve.
const BY_ONE_BOIL: f64 = 0.045;

/// Standard deviations of one boil from the median beyond which it does not count.
const MAX_SIGMAS_FROM_MEDIAN: f64 = 3.0;

/// Standard deviations from the class beyond which boils are not believed: the pots were put on warm.
const MAX_SIGMAS_FROM_CLASS: f64 = 2.5;

/// Largest differences of one pot at two placements: ln α, ln s and radius in metre. Its start's temperature is in ln s.
const MAX_PLACEMENT_DIFFERENCES: [f64; 3] = [0.15, 0.04, 4e-3];

/// Effects of heat by pot, relative to those of their classes, the newest last.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<KnownAlloy>")]
pub struct KnownAlloys(Vec<KnownAlloy>);

/// Error of stored alloys: more than are remembered, or numbers that no boil gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no effects of heat that boils have taught")]
pub struct ImpossibleAlloys;

impl TryFrom<Vec<KnownAlloy>> for KnownAlloys {
    type Error = ImpossibleAlloys;

    fn try_from(all: Vec<KnownAlloy>) -> Result<Self, ImpossibleAlloys> {
        let is_sound = all.len() <= MAX_POTS && all.iter().all(KnownAlloy::is_sound);
        is_sound.then_some(Self(all)).ok_or(ImpossibleAlloys)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownAlloy {
    metal: MetalLaw,
    numbers: [f64; 3],
    /// Effect by each boil, the newest last.
    effects: Vec<f64>,
}

impl KnownAlloy {
    fn is_sound(&self) -> bool {
        let all = self.numbers.iter().chain(&self.effects);
        (1..=MAX_BOILS).contains(&self.effects.len()) && all.into_iter().all(|x| x.is_finite())
    }

    fn is_of(&self, placed: &PlacedPot) -> bool {
        let pairs = self.numbers.into_iter().zip(numbers(placed));
        self.metal == placed.metal
            && pairs
                .zip(MAX_PLACEMENT_DIFFERENCES)
                .all(|((a, b), most)| (a - b).abs() < most)
    }

    /// Median of the effects, of which there is one at least.
    fn median(&self) -> f64 {
        median(&mut self.effects.clone()).unwrap_or(1.0)
    }
}

fn numbers(placed: &PlacedPot) -> [f64; 3] {
    let pot = &placed.pot;
    [pot.ln_alpha, pot.ln_s, pot.radius_m]
}

impl KnownAlloys {
    /// Effect of heat on a pot's metal and its standard deviation, both relative to the class, whose alloys have the deviation
    /// `spread`.
    pub(crate) fn effect(&self, placed: &PlacedPot, spread: f64) -> (f64, f64) {
        let Some(known) = self.0.iter().rev().find(|known| known.is_of(placed)) else {
            return (1.0, spread);
        };
        // A boil of a pot that was put on warm is far from the others.
        let median = known.median();
        let near = |effect: &f64| (effect - median).abs() < MAX_SIGMAS_FROM_MEDIAN * BY_ONE_BOIL;
        let near: Vec<f64> = known.effects.iter().copied().filter(near).collect();
        let boils = near.len() as f64;
        let mean = near.iter().sum::<f64>() / boils;
        let sigma = BY_ONE_BOIL / boils.sqrt();
        if near.is_empty() || (mean - 1.0).abs() > MAX_SIGMAS_FROM_CLASS * spread.hypot(sigma) {
            return (1.0, spread);
        }
        let (prior, measured) = (spread.powi(-2), sigma.powi(-2));
        let sum = prior + measured;
        ((prior + measured * mean) / sum, sum.sqrt().recip())
    }

    /// Learns from a boil at a rise in kelvin by the law `metal` of this pot.
    pub(crate) fn teach(&mut self, placed: &PlacedPot, metal: &MetalLaw, boil_k: f64) {
        let effect = metal.ln_s_change(boil_k).0 / placed.metal.ln_s_change(BOIL_K).0;
        if !effect.is_finite() {
            return;
        }
        let at = self.0.iter().rposition(|known| known.is_of(placed));
        let mut known = at.map_or_else(
            || KnownAlloy {
                metal: placed.metal,
                numbers: numbers(placed),
                effects: Vec::new(),
            },
            |at| self.0.remove(at),
        );
        if known.effects.len() == MAX_BOILS {
            known.effects.remove(0);
        }
        known.effects.push(effect);
        if self.0.len() == MAX_POTS {
            self.0.remove(0);
        }
        self.0.push(known);
    }
}

#[cfg(test)]
mod tests {
    use ihd_map::PotModel;

    use super::*;

    fn pot(radius_m: f64) -> PlacedPot {
        PlacedPot {
            pot: PotModel {
                radius_m,
                ..PotModel::PAPER
            },
            metal: MetalLaw::FERRITIC,
            is_heated_already: false,
            margin: 20.0,
            misfit: 0.1,
        }
    }

    /// Rise by the class at which a metal of this effect is when water put on at 20 °C boils.
    fn boils_at_k(effect: f64, used: &MetalLaw) -> f64 {
        let change = effect * MetalLaw::FERRITIC.ln_s_change(80.0).0;
        let all = (0..1800).map(|k| f64::from(k) * 0.1);
        let off = |k: f64| (used.ln_s_change(k).0 - change).abs();
        all.min_by(|a, b| off(*a).total_cmp(&off(*b)))
            .expect("some")
    }

    #[test]
    fn boils_teach_the_effect_whatever_law_they_were_seen_with() {
        let mut alloys = KnownAlloys::default();
        assert_eq!(alloys.effect(&pot(0.09), 0.12), (1.0, 0.12));
        for _ in 0..3 {
            let (used, _) = alloys.effect(&pot(0.09), 0.12);
            let law = MetalLaw::FERRITIC.with_effect(used);
            alloys.teach(&pot(0.091), &law, boils_at_k(1.15, &law));
        }
        let (effect, sigma) = alloys.effect(&pot(0.09), 0.12);
        assert!(
            (effect - 1.15).abs() < 0.01 && sigma < 0.03,
            "{effect} {sigma}"
        );
        assert_eq!(alloys.effect(&pot(0.07), 0.12), (1.0, 0.12));
    }

    #[test]
    fn one_pot_that_was_put_on_warm_is_outvoted_and_alone_not_believed() {
        let mut alloys = KnownAlloys::default();
        let law = MetalLaw::FERRITIC;
        // Water of 60 °C.
        alloys.teach(&pot(0.09), &law, 40.0);
        assert_eq!(alloys.effect(&pot(0.09), 0.12), (1.0, 0.12));
        for _ in 0..2 {
            alloys.teach(&pot(0.09), &law, boils_at_k(0.9, &law));
        }
        let (effect, _) = alloys.effect(&pot(0.09), 0.12);
        assert!((effect - 0.9).abs() < 0.01, "{effect}");
    }
}
