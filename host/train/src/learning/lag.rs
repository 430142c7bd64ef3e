//! Lag of R and L behind the current's amplitude. With a lag, their values at one current differ between the rising and the falling flank
//! of the half-cycle.
//!
//! Eddy currents in the pot make R and L depend on a part of the switching period before; the simulator's laws use the amplitude of the
//! period before. A lag of 14 µs is 0.4 % of R where R falls by a quarter within a millisecond.

use ihd_map::RlPrediction;
use ihd_pinn::Identification;
use serde::{Deserialize, Serialize};

/// Share of the past that counts at the next window of those that are taken, as in the map's curves.
const FORGETTING: f64 = 0.98;

/// First windows, which are all taken, and the share of the later ones: the map's law along a window costs as much as the rest of its
/// learning, and a lag changes with the pot only.
const ALL_TAKEN: u32 = 16;
const ONE_TAKEN_OF: u32 = 8;

/// Longest lag in seconds: three switching periods at 30 kHz. A load that lags more is no function of its current.
const MAX_LAG_S: f64 = 100e-6;

/// Share of the largest current from which a time counts.
const MIN_CURRENT_SHARE: f64 = 0.05;

/// Least-squares estimate of the lag over windows: deviations from the map's law against the law's slope in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lag {
    weighted_s: f64,
    weight: f64,
    /// Windows so far, taken or not.
    #[serde(default)]
    windows: u32,
}

impl Lag {
    /// Counts a window; returns `true` if it is one of those to add.
    pub fn takes_next(&mut self) -> bool {
        let before = self.windows;
        self.windows = before.saturating_add(1);
        before < ALL_TAKEN || before.is_multiple_of(ONE_TAKEN_OF)
    }

    /// Adds a window; `law` is R and L at its currents without lag.
    pub fn add_window(&mut self, identified: &Identification, law: &[RlPrediction]) {
        let most_a = identified.i_amplitude_a.iter().copied().fold(0.0, f64::max);
        let (mut product, mut square) = (0.0, 0.0);
        for k in 1..law.len().min(identified.t_s.len()).saturating_sub(1) {
            let i_a = identified.i_amplitude_a[k];
            if i_a < MIN_CURRENT_SHARE * most_a {
                continue;
            }
            let step_s = identified.t_s[k + 1] - identified.t_s[k - 1];
            let of = |measured: f64, law: [f64; 3], share: f64| {
                let slope = (law[2] / law[0]).ln() / step_s;
                let off = (measured / law[1]).ln();
                // Noise of R and of L is as V over I: relative to them, as Z over each.
                let weight = (i_a * share).powi(2);
                (-weight * off * slope, weight * slope * slope)
            };
            let r = of(
                identified.r_ohm[k],
                [k - 1, k, k + 1].map(|n| law[n].r_ohm),
                law[k].r_ohm,
            );
            // ωL near 50 kHz; it only weighs L against R.
            let x_ohm = 3e5 * law[k].l_h;
            let l = of(
                identified.l_h[k],
                [k - 1, k, k + 1].map(|n| law[n].l_h),
                x_ohm,
            );
            product += r.0 + l.0;
            square += r.1 + l.1;
        }
        if product.is_finite() && square.is_finite() {
            self.weighted_s = FORGETTING * self.weighted_s + product;
            self.weight = FORGETTING * self.weight + square;
        }
    }

    /// Returns the lag in seconds; 0 before the first window.
    pub fn seconds(&self) -> f64 {
        let lag_s = if self.weight > 0.0 {
            self.weighted_s / self.weight
        } else {
            0.0
        };
        lag_s.clamp(0.0, MAX_LAG_S)
    }

    /// Returns the amplitudes in ampere, one lag earlier, that R and L belong to at the times of a window.
    pub fn lagged_currents_a(&self, identified: &Identification) -> Vec<f64> {
        let (t_s, i_a) = (&identified.t_s, &identified.i_amplitude_a);
        let (Some(first), Some(last), true) = (t_s.first(), t_s.last(), t_s.len() > 1) else {
            return i_a.clone();
        };
        let step_s = (last - first) / (t_s.len() - 1) as f64;
        let back = self.seconds() / step_s;
        let at = |k: usize| {
            let place = (k as f64 - back).max(0.0);
            let below = (place as usize).min(t_s.len() - 2);
            i_a[below] + (place - below as f64) * (i_a[below + 1] - i_a[below])
        };
        (0..t_s.len()).map(at).collect()
    }

    /// Returns `true` if the sums are finite and the weight is not negative.
    pub fn is_sound(&self) -> bool {
        self.weighted_s.is_finite() && self.weight.is_finite() && self.weight >= 0.0
    }
}
