//! Detection of the turnover: the side of the maximum of R and L over temperature on which a pot is.
//!
//! R and L grow with heat up to a rise of some 200 K and fall beyond it, so that the same R and L belong to two temperatures. The filter
//! alone would bounce off the turn from both sides. A base with constant power does not cool down slowly by itself, and one with less
//! power does not slowly warm up. A slow reversal under such a power therefore means that the turn was passed. A quick one (cold food,
//! a new pot) does not.

use crate::metal::MetalLaw;

/// Distance of ΔT from its extreme, in kelvin, that noise does not explain.
const BACK_K: f64 = 6.0;

/// Least duration of the reversal in seconds: cold food cools a base as much within some seconds.
const SLOW_S: f64 = 12.0;

/// Least effect of heat on ln s at the extreme, over its maximum, for an extreme that may be the turn. The rest allows for another
/// alloy of the class and the filter's own error.
const MIN_EFFECT_SHARE: f64 = 0.95;

/// Power over that of the extreme: least value of constant heating, and largest value of less heating.
const POWER: (f64, f64) = (0.95, 0.5);

/// Time constant of the mean power in seconds.
const POWER_S: f64 = 15.0;

/// Detector of the passage of the turn, from ΔT and power.
#[derive(Clone, Debug, Default)]
pub struct TurnoverDetector {
    beyond: bool,
    last_s: Option<f64>,
    mean_w: f64,
    /// Power in watt at which the turn was passed.
    passed_w: f64,
    /// Least ΔT since a reversal by another cause, or largest beyond the turn; `None` if there was none.
    waits: Option<f64>,
    /// Largest ΔT, or least beyond the turn, with its time and power.
    extreme: Option<(f64, f64, f64)>,
}

impl TurnoverDetector {
    /// Returns `true` if the pot is beyond the turn.
    pub fn is_beyond(&self) -> bool {
        self.beyond
    }

    /// Adds ΔT and power at a time; returns ΔT on the other side if the turn was passed, else `None`.
    pub fn update(&mut self, metal: &MetalLaw, t_s: f64, rise_k: f64, power_w: f64) -> Option<f64> {
        let dt_s = self.last_s.map_or(0.0, |last_s| t_s - last_s).max(0.0);
        self.last_s = Some(t_s);
        let share = 1.0 - (-dt_s / POWER_S).exp();
        self.mean_w += share * (power_w - self.mean_w);
        // All is mirrored beyond the turn.
        let sign = if self.beyond { -1.0 } else { 1.0 };
        if let Some(least_k) = self.waits {
            // Another cause reversed it: extremes count only once ΔT rises again.
            self.waits = Some(if sign * rise_k < sign * least_k {
                rise_k
            } else {
                least_k
            });
            if sign * (rise_k - least_k) < BACK_K {
                return None;
            }
            (self.waits, self.extreme) = (None, None);
        }
        if self
            .extreme
            .is_none_or(|(extreme_k, ..)| sign * (rise_k - extreme_k) >= 0.0)
        {
            self.extreme = Some((rise_k, t_s, self.mean_w));
            return None;
        }
        let (extreme_k, at_s, then_w) = self.extreme?;
        if sign * (extreme_k - rise_k) < BACK_K {
            return None;
        }
        let turn_k = metal.turning_rise_k();
        let near = metal.ln_s_change(extreme_k).0 > MIN_EFFECT_SHARE * metal.ln_s_change(turn_k).0;
        let fits = match self.beyond {
            false => self.mean_w >= POWER.0 * then_w && then_w > 0.0,
            true => self.mean_w <= POWER.1 * self.passed_w,
        };
        if turn_k.is_finite() && near && fits && t_s - at_s > SLOW_S {
            self.beyond = !self.beyond;
            self.passed_w = then_w;
            let there_k = mirrored(metal, rise_k);
            self.extreme = None;
            return Some(there_k);
        }
        self.waits = Some(rise_k);
        None
    }
}

/// Rise on the other side of the turn with the same effect.
fn mirrored(metal: &MetalLaw, rise_k: f64) -> f64 {
    let turn_k = metal.turning_rise_k();
    let effect = metal.ln_s_change(rise_k).0;
    // Both sides are monotone, so that bisection finds it.
    let (mut low, mut high) = match rise_k < turn_k {
        true => (turn_k, turn_k + 400.0),
        false => (0.0, turn_k),
    };
    let falls = rise_k < turn_k;
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let above = metal.ln_s_change(middle).0 > effect;
        if above == falls {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_other_side_has_the_same_effect() {
        for metal in MetalLaw::ALL {
            for rise_k in [120.0, 180.0, 320.0] {
                let other_k = mirrored(&metal, rise_k);
                let turn_k = metal.turning_rise_k();
                assert!((rise_k < turn_k) == (other_k > turn_k));
                let effect = |k| metal.ln_s_change(k).0;
                assert!(
                    (effect(rise_k) - effect(other_k)).abs() < 1e-9,
                    "{rise_k} {other_k}"
                );
            }
        }
    }

    /// Result for a curve of ΔT at 1 Hz.
    fn passed(curve: impl Fn(f64) -> f64, power_w: impl Fn(f64) -> f64) -> Option<f64> {
        let mut turnover = TurnoverDetector::default();
        (0..300).find_map(|t| {
            let t_s = f64::from(t);
            turnover.update(&MetalLaw::FERRITIC, t_s, curve(t_s), power_w(t_s))
        })
    }

    #[test]
    fn a_slow_turn_back_under_the_same_power_is_the_turn() {
        let bounce = |t_s: f64| 176.0 - 0.005 * (t_s - 150.0) * (t_s - 150.0);
        assert!(passed(bounce, |_| 1000.0).is_some_and(|k| (190.0..215.0).contains(&k)));
        // The cook has turned it down.
        assert_eq!(
            passed(bounce, |t_s| if t_s < 145.0 { 1000.0 } else { 300.0 }),
            None
        );
        // Cold food.
        let food = |t_s: f64| 176.0 - 1.5 * (t_s - 150.0).clamp(0.0, 30.0);
        assert_eq!(passed(food, |_| 1000.0), None);
        // Far from the turn.
        assert_eq!(passed(|t_s| bounce(t_s) - 100.0, |_| 1000.0), None);
    }
}
