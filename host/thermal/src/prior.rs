//! Range of ΔT that the heat alone allows, and the posterior within it.
//!
//! A base cannot be hotter than if it had kept all of its heat, nor colder than when it was put on while it is heated. The filter
//! knows neither: R and L of a pot that is moved or of an unknown alloy may point anywhere.

use std::f64::consts::{PI, SQRT_2};

/// ΔT in kelvin below which no pot falls: one that was put on at 80 °C and cools to the room.
const COOLS_TO_K: f64 = -60.0;

/// Losses of such a pot to glass and room in W/K. A mean power that covers them lets no pot cool by itself.
const LOSSES_W_PER_K: f64 = 10.0;

/// ΔT in kelvin below which no heated pot falls: one from the room that ice is put in.
const CHILLED_TO_K: f64 = -20.0;

/// Rise in kelvin that a pot may have beyond its heat: heat that a hob's glass still holds.
const BEYOND_K: f64 = 20.0;

/// Ratio of the heat capacity that is assumed to the smallest of a base of that diameter.
pub(crate) const CAPACITY_MARGIN: f64 = 1.4;

/// ΔT in kelvin that no pot outlives: aluminium melts, enamel comes off.
const MAX_K: f64 = 600.0;

/// Standard deviations outside of the bounds beyond which measurement and heat contradict each other.
const CONTRADICTION_SIGMAS: f64 = 3.0;

/// Uniform distribution of ΔT between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeatPrior {
    low_k: f64,
    high_k: f64,
}

impl HeatPrior {
    /// Prior of a base of this heat capacity in J/K, `since_s` seconds after it was put on and after so much heat in joule.
    pub fn new(heat_j: f64, since_s: f64, base_j_per_k: f64) -> Self {
        let kept_k = CAPACITY_MARGIN * heat_j.max(0.0) / base_j_per_k;
        let mean_w = heat_j.max(0.0) / since_s.max(1.0);
        Self {
            low_k: (COOLS_TO_K + mean_w / LOSSES_W_PER_K).min(CHILLED_TO_K),
            high_k: (kept_k + BEYOND_K).min(MAX_K),
        }
    }

    /// Mean and standard deviation in kelvin by heat alone, which warms: ΔT is at least 0.
    pub fn mean_k(&self) -> (f64, f64) {
        (0.5 * self.high_k, self.high_k / 12f64.sqrt())
    }

    /// Mean and standard deviation in kelvin of a normal measurement within the bounds: a truncated normal distribution. If the
    /// measurement contradicts the bounds, the deviation is at least its distance from them.
    pub fn posterior_k(&self, (rise_k, sigma_k): (f64, f64)) -> (f64, f64) {
        let outside_k = (self.low_k - rise_k).max(rise_k - self.high_k);
        if sigma_k.is_nan() || outside_k > CONTRADICTION_SIGMAS * sigma_k {
            let width_k = self.high_k - self.low_k;
            return (
                rise_k.clamp(self.low_k, self.high_k),
                outside_k.clamp(0.0, width_k),
            );
        }
        if sigma_k <= 0.0 {
            return (rise_k, 0.0);
        }
        let (a, b) = (
            (self.low_k - rise_k) / sigma_k,
            (self.high_k - rise_k) / sigma_k,
        );
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
        let prior = HeatPrior::new(60e3, 60.0, 600.0);
        for (rise_k, sigma_k) in [(-83.0, 66.0), (40.0, 5.0), (220.0, 30.0), (60.0, 400.0)] {
            let (mean_k, deviation_k) = prior.posterior_k((rise_k, sigma_k));
            let exact = summed(&prior, rise_k, sigma_k);
            assert!((-20.0..=160.0).contains(&mean_k), "{rise_k}: {mean_k}");
            assert!((mean_k - exact.0).abs() < 0.5, "{mean_k} {exact:?}");
            assert!((deviation_k - exact.1).abs() < 0.5, "{exact:?}");
        }
        // What lies well within stays as it is.
        assert_eq!(prior.posterior_k((40.0, 2.0)).0, 40.0);
        // A pot that cools while it is heated: one of both is wrong, and the deviation says so.
        let (mean_k, deviation_k) = prior.posterior_k((-120.0, 3.0));
        assert!(mean_k >= -20.0 && deviation_k >= 100.0, "{deviation_k}");
    }

    #[test]
    fn heat_alone_only_warms_and_a_warm_pot_cools_where_power_is_low() {
        let heated = HeatPrior::new(1200.0 * 10.0, 10.0, 600.0);
        let (mean_k, sigma_k) = heated.mean_k();
        assert!(mean_k - 1.8 * sigma_k > -1.0, "{mean_k} {sigma_k}");
        // Put on at 80 °C, kept at 100 W: it may be 50 K colder.
        let cools = HeatPrior::new(100.0 * 900.0, 900.0, 600.0);
        assert_eq!(cools.posterior_k((-45.0, 0.5)).0, -45.0);
        assert!(heated.posterior_k((-45.0, 0.5)).1 > 20.0);
    }
}
