//! Measured R and L over current at one switching frequency, with deviations; windows of one frequency are fused.

use serde::{Deserialize, Serialize};

use crate::drift::Drift;
use crate::misfit::current_knots;

/// Bins per knot of the lookup's current axis.
const PER_KNOT: f64 = 1.5;

/// Most bins of a curve: up to twice the highest current of the lookup.
pub const MAX_BINS: usize = 32;

/// Share of a curve's weight that remains when another window is fused: about fifty windows count, ten seconds.
const KEPT_WEIGHT_SHARE: f64 = 0.98;

/// Least relative deviations of R and L at the largest current, which no number of windows reduces; they grow as the current
/// falls. They cover errors of bins and sensors.
const MIN_SIGMA: [f64; 2] = [2e-4, 1e-4];

/// Relative deviations of R and L at the largest current that the network has in common at all windows: it rounds off R and L where
/// the current rises steeply (host/train/src/trainer/deviations.rs). They grow as the current falls.
const COMMON_SIGMA: [f64; 2] = [1.8e-4, 1.4e-4];

/// Reach of that error in ln of the current over the largest one.
const COMMON_REACH: f64 = 1.0;

/// Range of switching frequencies in hertz, wider than that of any hob.
pub(crate) const FREQUENCIES_HZ: std::ops::RangeInclusive<f64> = 5e3..=500e3;

/// Relative deviations of one window's R and L at an amplitude in ampere, beside noise: of bins and sensors, and what the network has in
/// common at all windows. `most_a` is the window's largest amplitude.
pub fn window_floor(i_a: f64, most_a: f64) -> [f64; 2] {
    let grown = grown(i_a, most_a);
    [0, 1].map(|q| MIN_SIGMA[q].hypot(COMMON_SIGMA[q]) * grown)
}

/// Growth of a deviation from the largest current down to this one.
fn grown(i_a: f64, most_a: f64) -> f64 {
    most_a / i_a.max(1e-3)
}

/// R and L at one current, with independent errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPoint {
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Standard deviation of R in ohm, on the assumption that no other point shares its error.
    pub r_sigma_ohm: f64,
    /// Standard deviation of L in henry.
    pub l_sigma_h: f64,
}

/// Weighted means of R and L over a bin of currents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// Weight of R, Σ 1/σ² in 1/Ω².
    r_weight: f64,
    r_weighted: f64,
    /// Weight of L, Σ 1/σ² in 1/H².
    l_weight: f64,
    l_weighted: f64,
    i_weighted: f64,
}

impl Bin {
    fn add(&mut self, p: &MeasuredPoint) {
        let (r, l) = (p.r_sigma_ohm.powi(-2), p.l_sigma_h.powi(-2));
        self.r_weight += r;
        self.r_weighted += r * p.r_ohm;
        self.l_weight += l;
        self.l_weighted += l * p.l_h;
        self.i_weighted += r * p.i_a;
    }

    fn fuse(&mut self, other: &Self, kept: f64) {
        let mix = |a: &mut f64, b: f64| *a = kept * *a + b;
        mix(&mut self.r_weight, other.r_weight);
        mix(&mut self.r_weighted, other.r_weighted);
        mix(&mut self.l_weight, other.l_weight);
        mix(&mut self.l_weighted, other.l_weighted);
        mix(&mut self.i_weighted, other.i_weighted);
    }

    /// R in ohm and L in henry; NaN if the bin is empty.
    fn load(&self) -> [f64; 2] {
        [
            self.r_weighted / self.r_weight,
            self.l_weighted / self.l_weight,
        ]
    }

    /// Inverse variances of ln R and ln L; 0 if the bin is empty.
    fn ln_weights(&self) -> [f64; 2] {
        let [r_ohm, l_h] = self.load();
        [self.r_weight * r_ohm * r_ohm, self.l_weight * l_h * l_h]
            .map(|weight| if weight.is_finite() { weight } else { 0.0 })
    }

    /// Mean of the bin, with variances of the curve's level; `None` if it is empty or its R and L are no load.
    fn mean(&self, most_a: f64, level: [f64; 2]) -> Option<Mean> {
        let [r_ohm, l_h] = self.load();
        let sound = r_ohm > 0.0 && l_h > 0.0 && r_ohm.is_finite() && l_h.is_finite();
        let i_a = self.i_a();
        let weights = self.ln_weights();
        let grown = grown(i_a, most_a);
        let relative = |q: usize| 1.0 / weights[q] + (MIN_SIGMA[q] * grown).powi(2);
        sound.then(|| Mean {
            i_a,
            ln: [r_ohm.ln(), l_h.ln()],
            variance: [0, 1].map(relative),
            level,
            common: COMMON_SIGMA.map(|sigma| sigma * grown),
        })
    }

    /// Mean amplitude of the current in ampere; NaN if the bin is empty.
    fn i_a(&self) -> f64 {
        self.i_weighted / self.r_weight
    }

    fn scale(&mut self, r: f64, l: f64) {
        self.r_weighted *= r;
        self.l_weighted *= l;
    }

    fn is_sound(&self) -> bool {
        let all = [
            self.r_weight,
            self.r_weighted,
            self.l_weight,
            self.l_weighted,
            self.i_weighted,
        ];
        all.iter().all(|x| x.is_finite()) && self.r_weight >= 0.0 && self.l_weight >= 0.0
    }
}

/// Mean of a bin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Amplitude of the current in ampere.
    pub i_a: f64,
    /// ln of R in ohm and of L in henry.
    pub ln: [f64; 2],
    /// Variances of `ln`, independent from mean to mean.
    pub variance: [f64; 2],
    /// Variances of `ln` that all means of a curve share: its level, which may have drifted.
    pub level: [f64; 2],
    /// Deviations of `ln` that windows of all frequencies share (`common_covariance`).
    pub common: [f64; 2],
}

/// Covariance of the errors that two means have in common, from their deviations; 0 if one has none.
pub(crate) fn common_covariance(a: f64, b: f64) -> f64 {
    let product = a * b;
    if product <= 0.0 {
        return 0.0;
    }
    // The deviation grows as one over the current.
    let apart = (a / b).ln() / COMMON_REACH;
    product * (-0.5 * apart * apart).exp()
}

/// R and L over current at one switching frequency.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurrentCurve {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Time of the newest window in seconds of the device.
    pub t_s: f64,
    /// Number of windows that were fused.
    pub windows: u32,
    bins: Vec<Bin>,
    /// Drift of R and L; absent in states of builds that did not follow it.
    #[serde(default = "no_drift")]
    drift: [Drift; 2],
}

fn no_drift() -> [Drift; 2] {
    [0, 1].map(|q| Drift::new(q, MIN_SIGMA[q].powi(2)))
}

impl CurrentCurve {
    /// Creates a curve from one window; points that are not numbers, or have no deviations, are left out.
    pub fn new(f_sw_hz: f64, t_s: f64, points: impl Iterator<Item = MeasuredPoint>) -> Self {
        let mut bins = vec![Bin::default(); MAX_BINS];
        for p in points {
            let at = (current_knots(p.i_a) * PER_KNOT) as usize;
            let all = [p.i_a, p.r_ohm, p.l_h, p.r_sigma_ohm, p.l_sigma_h];
            let positive = p.r_sigma_ohm > 0.0 && p.l_sigma_h > 0.0;
            if let (Some(bin), true, true) = (
                bins.get_mut(at),
                all.iter().all(|x| x.is_finite()),
                positive,
            ) {
                bin.add(&p);
            }
        }
        let mut curve = Self {
            f_sw_hz,
            t_s,
            windows: 1,
            bins,
            drift: no_drift(),
        };
        let levels = curve.level_over(&curve, [1.0; 2]);
        curve.drift = [0, 1].map(|q| Drift::new(q, levels[q].map_or(0.0, |l| l.1)));
        curve
    }

    /// ln R and ln L of a window over those of this curve, as weighted means over the bins of both, with the window's variances.
    fn level_over(&self, window: &Self, ratio: [f64; 2]) -> [Option<(f64, f64)>; 2] {
        let mut sums = [[0.0f64; 2]; 2];
        for (bin, other) in self.bins.iter().zip(&window.bins) {
            let (mine, its, weights) = (bin.load(), other.load(), other.ln_weights());
            for q in 0..2 {
                let over = (its[q] * ratio[q] / mine[q]).ln();
                if over.is_finite() {
                    sums[q][0] += weights[q] * over;
                    sums[q][1] += weights[q];
                }
            }
        }
        [0, 1].map(|q| {
            let [weighted, weight] = sums[q];
            let variance = 1.0 / weight + MIN_SIGMA[q].powi(2);
            (weight > 0.0).then(|| (weighted / weight, variance))
        })
    }

    /// Fuses another window; `ratio` holds R and L at this curve's frequency over those at the window's frequency. The level follows
    /// the pot's drift; the form over current is a mean of some fifty windows.
    pub(crate) fn fuse(&mut self, other: &Self, ratio: [f64; 2]) {
        let step_s = (other.t_s - self.t_s).max(0.0);
        let seen = self.level_over(other, ratio);
        let (mut old, mut new) = ([1.0; 2], ratio);
        for q in 0..2 {
            let level = self.drift[q].follow(q, step_s, seen[q]);
            old[q] = level.exp();
            new[q] *= seen[q].map_or(1.0, |(its, _)| (level - its).exp());
        }
        for (bin, other) in self.bins.iter_mut().zip(&other.bins) {
            let mut other = *other;
            other.scale(new[0], new[1]);
            bin.scale(old[0], old[1]);
            bin.fuse(&other, KEPT_WEIGHT_SHARE);
        }
        self.t_s = self.t_s.max(other.t_s);
        self.windows = self.windows.saturating_add(other.windows);
    }

    /// Means of the bins that hold points, at rising currents.
    pub fn means(&self) -> impl Iterator<Item = Mean> + '_ {
        let most_a = self.bins.iter().map(Bin::i_a).fold(0.0, f64::max);
        let level = self.level_variance();
        self.bins
            .iter()
            .filter_map(move |bin| bin.mean(most_a, level))
    }

    /// Variances of the level beyond those that the bins' own have.
    fn level_variance(&self) -> [f64; 2] {
        [0, 1].map(|q| {
            let weight: f64 = self.bins.iter().map(|bin| bin.ln_weights()[q]).sum();
            (self.drift[q].level_variance() - 1.0 / weight).max(0.0)
        })
    }

    /// Returns `true` if windows can have produced these numbers.
    pub fn is_sound(&self) -> bool {
        let known = FREQUENCIES_HZ.contains(&self.f_sw_hz) && self.t_s.is_finite();
        known
            && self.bins.len() == MAX_BINS
            && self.bins.iter().all(Bin::is_sound)
            && self.drift.iter().all(Drift::is_sound)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(i_a: f64, r_ohm: f64) -> MeasuredPoint {
        MeasuredPoint {
            i_a,
            r_ohm,
            l_h: 20e-6,
            r_sigma_ohm: 0.01,
            l_sigma_h: 1e-7,
        }
    }

    #[test]
    fn windows_of_one_frequency_average_and_know_it() {
        let mut curve = CurrentCurve::new(45e3, 0.0, [point(20.0, 3.98)].into_iter());
        for k in 1u32..16 {
            let r_ohm = if k.is_multiple_of(2) { 3.98 } else { 4.02 };
            curve.fuse(
                &CurrentCurve::new(45e3, 0.0, [point(20.0, r_ohm)].into_iter()),
                [1.0; 2],
            );
        }
        let mean = curve.means().next().unwrap();
        assert!((mean.ln[0].exp() - 4.0).abs() < 2e-3);
        // Sixteen windows: a quarter of one window's deviation, .01/4, and a little more for the weight that is lost.
        assert!((2.4e-3 / 4.0..3e-3 / 4.0).contains(&mean.variance[0].sqrt()));
        assert_eq!((curve.t_s, curve.windows), (0.0, 16));
    }

    /// A pot that warms by .1 % of R a second: a mean of fifty windows, five a second, would be 1 % late.
    #[test]
    fn the_level_follows_a_warming_pot_and_the_form_remains_a_mean() {
        let law = |i_a: f64, k: u32| {
            let noise = if k.is_multiple_of(2) { 1e-3 } else { -1e-3 };
            (4.0 - 0.02 * i_a) * (1.0 + 1e-3 * 0.2 * f64::from(k)) * (1.0 + noise)
        };
        let currents = [10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0];
        let window = |k: u32| {
            let points = currents.map(|i_a| point(i_a, law(i_a, k)));
            CurrentCurve::new(45e3, 0.2 * f64::from(k), points.into_iter())
        };
        let mut curve = window(0);
        for k in 1..200 {
            curve.fuse(&window(k), [1.0; 2]);
            if k < 25 {
                continue;
            }
            for mean in curve.means() {
                let truth = (4.0 - 0.02 * mean.i_a) * (1.0 + 1e-3 * 0.2 * f64::from(k));
                let off = (mean.ln[0].exp() / truth - 1.0).abs();
                assert!(off < 6e-4, "window {k}, {} A: {off}", mean.i_a);
                assert!(off < 3.0 * mean.variance[0].sqrt(), "window {k}: {off}");
            }
        }
        assert!(curve.is_sound());
    }

    #[test]
    fn what_is_no_number_is_left_out() {
        let bad = [f64::NAN, f64::INFINITY].map(|x| point(20.0, x));
        let nothing = CurrentCurve::new(
            45e3,
            0.0,
            bad.into_iter().chain([MeasuredPoint {
                r_sigma_ohm: 0.0,
                ..point(3.0, 4.0)
            }]),
        );
        assert_eq!(nothing.means().count(), 0);
        assert!(
            CurrentCurve::new(45e3, 0.0, [point(-3.0, 4.0), point(1e9, 4.0)].into_iter())
                .means()
                .count()
                <= 1
        );
    }
}
