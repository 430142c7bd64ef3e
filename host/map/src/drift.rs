//! Level and drift of a curve: a pot that warms changes R and L at all currents alike, by a tenth of a percent of R a second.

use serde::{Deserialize, Serialize};

/// Standard deviations of the drift of ln R and ln L in 1/s, and the time in seconds for which a drift lasts (docs/map.md).
const DRIFT_PER_S: [f64; 2] = [1e-3, 3e-4];
const LASTS_S: f64 = 60.0;

/// Largest variance of a level: nothing is known.
const MAX_LEVEL_VARIANCE: f64 = 1.0;

/// Largest drift, and largest surprise that changes it, in standard deviations.
const MAX_DEVIATIONS: f64 = 10.0;

/// Kalman filter of a level and its drift, which is an Ornstein-Uhlenbeck process. The level is relative to that of the curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Drift {
    /// Change of the level per second.
    per_s: f64,
    level_variance: f64,
    per_s_variance: f64,
    covariance: f64,
}

impl Drift {
    /// Filter of R (0) or L (1) before the first window.
    pub fn new(quantity: usize, level_variance: f64) -> Self {
        Self {
            per_s: 0.0,
            level_variance: level_variance.min(MAX_LEVEL_VARIANCE),
            per_s_variance: DRIFT_PER_S[quantity].powi(2),
            covariance: 0.0,
        }
    }

    /// Variance of the level.
    pub fn level_variance(&self) -> f64 {
        self.level_variance
    }

    /// Follows the level over `step_s` seconds, and then to a window's level over that of the curve and its variance, if there is one.
    /// Returns the change of the level.
    pub fn follow(&mut self, quantity: usize, step_s: f64, seen: Option<(f64, f64)>) -> f64 {
        let stays = (-step_s / LASTS_S).exp();
        let reach_s = LASTS_S * (1.0 - stays);
        let widest = DRIFT_PER_S[quantity].powi(2);
        let expected = self.per_s * reach_s;
        let wandered = 2.0 * step_s / LASTS_S - 3.0 + 4.0 * stays - stays * stays;
        self.per_s *= stays;
        self.level_variance += 2.0 * reach_s * self.covariance
            + reach_s * reach_s * self.per_s_variance
            + widest * LASTS_S * LASTS_S * wandered.max(0.0);
        self.covariance = stays * (self.covariance + reach_s * self.per_s_variance)
            + widest * LASTS_S * (1.0 - stays) * (1.0 - stays);
        self.per_s_variance = stays * stays * self.per_s_variance + widest * (1.0 - stays * stays);
        self.level_variance = self.level_variance.min(MAX_LEVEL_VARIANCE);
        let Some((level, variance)) = seen else {
            return expected;
        };
        let all = self.level_variance + variance;
        let gains = [self.level_variance / all, self.covariance / all];
        let surprise = level - expected;
        let most = MAX_DEVIATIONS * DRIFT_PER_S[quantity];
        // A jump is no drift.
        let likely = MAX_DEVIATIONS * all.sqrt();
        let turned = gains[1] * surprise.clamp(-likely, likely);
        self.per_s = (self.per_s + turned).clamp(-most, most);
        self.per_s_variance = (self.per_s_variance - gains[1] * self.covariance).max(0.0);
        self.covariance *= 1.0 - gains[0];
        self.level_variance *= 1.0 - gains[0];
        expected + gains[0] * surprise
    }

    /// Returns `true` if windows can have produced these numbers: the variance of the drift never exceeds that of the process, and the
    /// covariance with the level is positive.
    pub fn is_sound(&self) -> bool {
        let most = DRIFT_PER_S[0];
        // Rounding may add a little.
        let most_variance = 1.01 * most * most;
        let most_covariance = (MAX_LEVEL_VARIANCE * most_variance).sqrt();
        self.per_s.abs() <= MAX_DEVIATIONS * most
            && (0.0..=MAX_LEVEL_VARIANCE).contains(&self.level_variance)
            && (0.0..=most_variance).contains(&self.per_s_variance)
            && (0.0..=most_covariance).contains(&self.covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_seen_long_ago_says_nothing_and_stays_sound() {
        let mut drift = Drift::new(0, 1e-7);
        assert_eq!(drift.follow(0, 1e9, None), 0.0);
        assert!(drift.is_sound());
        // The window alone counts.
        let level = drift.follow(0, 0.0, Some((0.3, 1e-6)));
        assert!((level - 0.3).abs() < 1e-5, "{level}");
        assert!(drift.is_sound() && drift.level_variance() <= 1e-6);
    }

    /// Each would make a deviation that is none of the next window's level, which has no range then.
    #[test]
    fn numbers_that_no_window_gives_are_unsound() {
        let sound = Drift::new(0, 1e-7);
        assert!(sound.is_sound());
        for covariance in [-1e-2, 1e300, f64::NAN] {
            let bad = Drift {
                covariance,
                ..sound
            };
            assert!(!bad.is_sound(), "{bad:?}");
        }
        for per_s_variance in [-1e-9, 1e300, f64::INFINITY] {
            let bad = Drift {
                per_s_variance,
                ..sound
            };
            assert!(!bad.is_sound(), "{bad:?}");
        }
    }

    #[test]
    fn a_jump_is_no_endless_drift() {
        let mut drift = Drift::new(0, 1e-8);
        for k in 0..1000 {
            let up = if k == 500 { 5.0 } else { 0.0 };
            drift.follow(0, 0.01, Some((up, 1e-8)));
            assert!(drift.is_sound(), "{k}: {drift:?}");
        }
        assert!(drift.per_s.abs() < 1e-3, "{drift:?}");
    }
}
