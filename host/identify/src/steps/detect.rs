//! Detection of steps of R or L: the impedance of a few periods before is compared with that of a few after.
//!
//! Natural changes are slow, and the noise depends only on the amplitude, so that a step exceeds both. Positions near the mains
//! zero crossings, where R and L have kinks, are not judged.

use std::f64::consts::TAU;

use ihd_signal::Segment;
use ihd_signal::carrier::HannFrames;
use ihd_signal::correlation::Correlator;
use ihd_signal::noise::median;
use nalgebra::Complex;

use crate::lockin::r_l;

/// Step of the load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Time of the step in seconds on the segment's clock.
    pub t_s: f64,
    /// R before and after in ohm.
    pub r_ohm: (f64, f64),
    /// L before and after in henry.
    pub l_h: (f64, f64),
}

/// Frames, one per switching period, that are averaged on either side.
const SIDE_FRAMES: usize = 5;

/// Frames between the two sides: a frame and its slope extend over two periods.
const GAP_FRAMES: usize = 4;

/// Frames from a position to the outermost one that is used.
const REACH_FRAMES: usize = SIDE_FRAMES + GAP_FRAMES / 2;

/// Switching periods on either side of a position in which the step is located.
const NEAR_PERIODS: f64 = 4.0;

/// Share of the largest current below which positions are not judged.
const MIN_CURRENT: f64 = 0.12;

/// Least step that is reported, as a share of the impedance.
const MIN_STEP_SHARE: f64 = 0.06;

/// Frames on either side of a step that show a part of it.
const BLURRED: usize = 2;

/// Least ratio to the median effect of noise: 7.5 standard deviations.
const MIN_NOISE_RATIO: f64 = 6.5;

/// Least ratio to the natural change of R and L nearby.
const MIN_TREND_RATIO: f64 = 5.0;

/// Steps in order of time.
pub(super) fn steps(segment: &Segment, frames: &HannFrames) -> Vec<Step> {
    let frames = Frames::compute(segment, frames);
    let differences: Vec<f64> = (0..frames.z.len()).map(|k| frames.difference(k)).collect();
    let weighted = |k: usize| differences[k] * frames.current(k);
    let noise = (0..differences.len()).filter(|k| differences[*k] > 0.0);
    let Some(noise) = median(&mut noise.map(weighted).collect::<Vec<_>>()) else {
        return Vec::new();
    };
    let stands_out = |k: &usize| {
        differences[*k] > MIN_STEP_SHARE
            && weighted(*k) > MIN_NOISE_RATIO * noise
            && differences[*k] > MIN_TREND_RATIO * trend(&differences, *k)
    };
    let mut candidates: Vec<usize> = (0..differences.len()).filter(stands_out).collect();
    candidates.sort_by(|a, b| differences[*b].total_cmp(&differences[*a]));
    let mut positions: Vec<usize> = Vec::new();
    for k in candidates {
        if positions
            .iter()
            .all(|other| k.abs_diff(*other) > REACH_FRAMES + BLURRED)
        {
            positions.push(k);
        }
    }
    positions.sort_unstable();
    let mut steps: Vec<Step> = positions.iter().map(|k| frames.step(segment, *k)).collect();
    // Echoes of a step are located at the step itself.
    let apart_s = BLURRED as f64 * frames.step_s;
    steps.dedup_by(|b, a| b.t_s - a.t_s < apart_s);
    steps
}

/// Natural change of R and L around a position: the lower quartile, which a step nearby does not affect.
fn trend(differences: &[f64], k: usize) -> f64 {
    let near = |j: &usize| {
        j.abs_diff(k) > REACH_FRAMES && j.abs_diff(k) <= 3 * REACH_FRAMES && differences[*j] > 0.0
    };
    let (from, to) = (
        k.saturating_sub(3 * REACH_FRAMES),
        (k + 3 * REACH_FRAMES + 1).min(differences.len()),
    );
    let mut x: Vec<f64> = (from..to).filter(near).map(|j| differences[j]).collect();
    x.sort_by(f64::total_cmp);
    x.get(x.len() / 4).copied().unwrap_or(0.0)
}

/// Impedance and current of every switching period.
struct Frames {
    /// R and ωL in ohm.
    z: Vec<Complex<f64>>,
    /// The current's amplitude as a share of the largest.
    i: Vec<f64>,
    /// Time of the first frame's middle in seconds.
    t0_s: f64,
    /// Time from one frame to the next in seconds.
    step_s: f64,
    omega: f64,
}

impl Frames {
    /// Computes frames of two periods under a Hann window, which suppresses offset and harmonics; the slope is taken from the
    /// frame before to the one after.
    fn compute(segment: &Segment, of: &HannFrames) -> Self {
        let (omega, step_s) = (TAU * segment.f_sw_hz, of.step_s());
        let turns = Correlator::new(segment, 1, [1.0]);
        let turned = |(k, (v, i)): (usize, (&Complex<f64>, &Complex<f64>))| {
            let [turn] = turns.turn(k * of.hop);
            (v * turn, i * turn)
        };
        let both = of.v.iter().zip(&of.i);
        let phasors: Vec<_> = both.enumerate().map(turned).collect();
        let largest = phasors
            .iter()
            .map(|p| p.1.norm())
            .fold(f64::MIN_POSITIVE, f64::max);
        let inner = phasors.windows(3);
        let (z, i) = inner
            .map(|w| {
                let ((_, before), (v, i), (_, after)) = (w[0], w[1], w[2]);
                let d = i * Complex::new(0.0, omega) + (after - before) / (2.0 * step_s);
                let (r, l) = r_l(v, i, d);
                (Complex::new(r, omega * l), i.norm() / largest)
            })
            .unzip();
        Self {
            z,
            i,
            t0_s: segment.t0_s + 0.5 * of.length as f64 * segment.dt_s + step_s,
            step_s,
            omega,
        }
    }

    /// Frames before and after the one at `k`; `None` near the ends.
    fn sides(&self, k: usize) -> Option<[std::ops::Range<usize>; 2]> {
        let before = k.checked_sub(REACH_FRAMES)?..k - GAP_FRAMES / 2;
        let after = k + GAP_FRAMES / 2 + 1..k + REACH_FRAMES + 1;
        (after.end <= self.z.len()).then_some([before, after])
    }

    /// Mean impedance in ohm, weighted with the current's power.
    fn mean(&self, frames: std::ops::Range<usize>) -> Complex<f64> {
        let weight = |k: &usize| self.i[*k] * self.i[*k];
        let sum: Complex<f64> = frames.clone().map(|k| self.z[k] * weight(&k)).sum();
        sum / frames.map(|k| weight(&k)).sum::<f64>()
    }

    /// Least current within reach.
    fn current(&self, k: usize) -> f64 {
        let reach = self.sides(k).map(|[before, after]| before.start..after.end);
        reach.map_or(0.0, |r| self.i[r].iter().copied().fold(1.0, f64::min))
    }

    /// Difference of the impedances before and after frame `k`, as a share of the smaller; 0 where positions are not judged.
    fn difference(&self, k: usize) -> f64 {
        let Some([before, after]) = self.sides(k).filter(|_| self.current(k) > MIN_CURRENT) else {
            return 0.0;
        };
        let (a, b) = (self.mean(before), self.mean(after));
        let share = (b - a).norm() / a.norm().min(b.norm());
        if share.is_finite() { share } else { 0.0 }
    }

    /// The step near frame `k`.
    fn step(&self, segment: &Segment, k: usize) -> Step {
        let mut k = k;
        let near_s = self.time_s(k);
        let mut t_s = near_s;
        // A better time improves the means, which improve the time.
        for _ in 0..2 {
            let (a, b) = self.means(k);
            t_s = self.place(segment, near_s, a, b);
            k = ((t_s - self.t0_s) / self.step_s).round().max(0.0) as usize;
        }
        let (a, b) = self.means(k);
        Step {
            t_s,
            r_ohm: (a.re, b.re),
            l_h: (a.im / self.omega, b.im / self.omega),
        }
    }

    /// Time of a frame's middle in seconds.
    fn time_s(&self, k: usize) -> f64 {
        self.t0_s + k as f64 * self.step_s
    }

    /// Mean impedance in ohm before and after frame `k`; fewer frames near the ends.
    fn means(&self, k: usize) -> (Complex<f64>, Complex<f64>) {
        let last = self.z.len().saturating_sub(REACH_FRAMES + 1);
        let k = k.clamp(REACH_FRAMES.min(last), last);
        let [before, after] = self.sides(k).unwrap_or([k..k + 1, k..k + 1]);
        (self.mean(before), self.mean(after))
    }

    /// Locates the step near `near_s`: the time in seconds up to which the impedance `a` explains the samples, and after which `b`
    /// does. Minimises the squared errors of v = R·i + L·di/dt over sixths of a period.
    fn place(&self, segment: &Segment, near_s: f64, a: Complex<f64>, b: Complex<f64>) -> f64 {
        let reach_s = NEAR_PERIODS * self.step_s;
        let from = segment.index_at(near_s - reach_s);
        let to = (segment.index_at(near_s + reach_s) + 1).min(segment.len());
        let length = (segment.samples_per_period() / 6.0).round().max(1.0) as usize;
        let near = segment.part(from, to);
        let error = |k: usize, z: Complex<f64>| {
            // Over an interval the current's slope is the difference of its ends, with little noise.
            let mean = |x: &[f64]| {
                let inner: f64 = x[k + 1..k + length].iter().sum();
                (inner + 0.5 * (x[k] + x[k + length])) / length as f64
            };
            let rise = near.i_a[k + length] - near.i_a[k];
            let slope = rise / (length as f64 * segment.dt_s);
            mean(&near.v_v) - z.re * mean(&near.i_a) - z.im / self.omega * slope
        };
        let (mut sum, mut least, mut best) = (0.0, 0.0, from);
        for k in 0..near.len().saturating_sub(length) {
            sum += error(k, a).powi(2) - error(k, b).powi(2);
            if sum < least {
                (least, best) = (sum, from + k + length.div_ceil(2));
            }
        }
        segment.t_s(best)
    }
}
