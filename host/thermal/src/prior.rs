//! Range of ΔT that the heat alone allows, and the posterior within it.
//!
//! A base cannot be hotter than if it had kept all of its heat, nor much colder than when it was put on. The filter knows
//! neither: R and L of a pot that is moved or of an unknown alloy may point anywhere.

use std::f64::consts::{PI, SQRT_2};

/// ΔT in kelvin below which no pot falls: one that was put on at 80 °C and cools to the room.
const COOLS_TO_K: f64 = -60.0;

/// Rise in kelvin that a pot may have beyond its heat: heat that a hob's glass still holds.
const BEYOND_K: f64 = 20.0;

/// Ratio of the heat capacity that is assumed to the smallest of a base of that diameter.
const CAPACITY_MARGIN: f64 = 1.4;

/// ΔT in kelvin that no pot outlives: aluminium melts, enamel comes off.
const MAX_K: f64 = 600.0;

/// Uniform distribution of ΔT between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeatPrior {
    low_k: f64,
    high_k: f64,
}

impl HeatPrior {
    /// Prior of a base of this heat capacity in J/K after so much heat in joule.
    pub fn new(heat_j: f64, base_j_per_k: f64) -> Self {
        let kept_k = CAPACITY_MARGIN * heat_j.max(0.0) / base_j_per_k;
        Self {
            low_k: COOLS_TO_K,
            high_k: (kept_k + BEYOND_K).min(MAX_K),
        }
    }

    /// Mean and standard deviation in kelvin.
    pub fn mean_k(&self) -> (f64, f64) {
        let width = self.high_k - self.low_k;
        (0.5 * (self.low_k + self.high_k), width / 12f64.sqrt())
    }

    /// Mean and standard deviation in kelvin of a normal measurement within the bounds: a truncated normal distribution.
    pub fn posterior_k(&self, (rise_k, sigma_k): (f64, f64)) -> (f64, f64) {
        if sigma_k.is_nan() || sigma_k <= 0.0 {
            return (rise_k.clamp(self.low_k, self.high_k), 0.0);
        }
        let (a, b) = (
            (self.low_k - rise_k) / sigma_k,
            (self.high_k - rise_k) / sigma_k,
        );
        // Beyond five standard deviations outside, the tail is exponential with the slope at the bound.
        if a > 5.0 || b < -5.0 {
            let (bound_k, off) = if a > 5.0 {
                (self.low_k, a)
            } else {
                (self.high_k, b)
            };
            let width_k = (sigma_k / off.abs()).min(self.mean_k().1);
            let inward = if a > 5.0 { width_k } else { -width_k };
            return (bound_k + inward, width_k);
        }
        let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * PI).sqrt();
        // Φ(b) − Φ(a), from the side where both are small.
        let upper = |x: f64| 0.5 * libm::erfc(x / SQRT_2);
        let share = match a > 0.0 {
            true => upper(a) - upper(b),
            false => upper(-b) - upper(-a),
        };
        let first = (density(a) - density(b)) / share;
        let weighed = |x: f64| if x.is_finite() { x * density(x) } else { 0.0 };
        let second = (weighed(a) - weighed(b)) / share;
        let variance = (1.0 + second - first * first).max(0.0);
        let mean_k = (rise_k + sigma_k * first).clamp(self.low_k, self.high_k);
        (mean_k, sigma_k * variance.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and deviation by a sum over the range.
    fn summed(prior: &HeatPrior, rise_k: f64, sigma_k: f64) -> (f64, f64) {
        let n = 20_000;
        let (mut w, mut x, mut xx) = (0.0, 0.0, 0.0);
        for k in 0..n {
            let at =
                prior.low_k + (prior.high_k - prior.low_k) * (f64::from(k) + 0.5) / f64::from(n);
            let weight = (-0.5 * ((at - rise_k) / sigma_k).powi(2)).exp();
            w += weight;
            x += weight * at;
            xx += weight * at * at;
        }
        (x / w, (xx / w - (x / w).powi(2)).sqrt())
    }

    #[test]
    fn an_impossible_temperature_is_never_shown() {
        // 60 kJ into a base of 600 J/K: 100 K if nothing were lost.
        let prior = HeatPrior::new(60e3, 600.0);
        for (rise_k, sigma_k) in [
            (-83.0, 66.0),
            (40.0, 5.0),
            (250.0, 30.0),
            (-200.0, 20.0),
            (60.0, 400.0),
        ] {
            let (mean_k, deviation_k) = prior.posterior_k((rise_k, sigma_k));
            assert!((-60.0..=160.0).contains(&mean_k), "{rise_k}: {mean_k}");
            let exact = summed(&prior, rise_k, sigma_k);
            assert!(
                (mean_k - exact.0).abs() < 0.5,
                "{rise_k}: {mean_k} {exact:?}"
            );
            assert!(
                (deviation_k - exact.1).abs() < 0.5,
                "{rise_k}: {deviation_k} {exact:?}"
            );
        }
        // What lies well within stays as it is.
        assert_eq!(prior.posterior_k((40.0, 2.0)).0, 40.0);
        let (mean_k, _) = prior.mean_k();
        assert!((mean_k - 50.0).abs() < 1e-9);
    }
}
