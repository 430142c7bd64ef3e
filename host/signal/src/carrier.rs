//! Tracking of the switching frequency by the phase of voltage and current, as a base for time warping to a constant frequency.
//!
//! With a smooth phase φ(t) and τ = φ(t)/ω0 the coil's v = R·i + L·di/dt becomes v = R·i + L'·di/dτ with
//! L' = L·φ̇/ω0. This holds for any φ, so that an error of the tracked phase costs nothing while the carrier's remaining
//! rotation is slow. [`crate::warp`] converts samples to constant frequency, the estimator finds R and L' there, and L = L'·ω0/φ̇.

mod frames;
mod smooth;

use std::f64::consts::TAU;

pub use self::frames::HannFrames;
use crate::Segment;

/// Cut-off of the tracking in hertz: a sweep of 1 kHz is followed to 2 %, and the rest is slow.
const CUT_OFF_HZ: f64 = 2.7e3;

/// Deviation in hertz within which a constant carrier has four fifths of its energy; the load turns its phase as R and L
/// follow the current. At most 26 Hz were seen (30 kHz, near resonance), 13 Hz at 20 dB. A carrier that moves less costs
/// estimators that take it as constant no more than .07/.04 % (at 1 kHz; nothing at 300 Hz).
const MOVES_HZ: f64 = 60.0;

/// Share of the energy beyond [`MOVES_HZ`] above which the carrier counts as moving.
const MAX_OFTEN: f64 = 0.2;

/// Largest deviation in hertz that a step of the load shows for some periods.
const MOVES_FAR_HZ: f64 = 250.0;

/// Share of the energy beyond [`MOVES_FAR_HZ`] above which the carrier moves: a third of a millisecond per half-cycle.
const MAX_RARELY: f64 = 0.04;

/// Share of the largest power above which a value is the carrier's frequency and not noise.
const MIN_POWER_SHARE: f64 = 0.05;

/// Motion of a carrier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Mean in hertz, weighted with the carrier's power.
    pub mean_hz: f64,
    /// Half the distance between the smallest and the largest frequency, in hertz.
    pub deviation_hz: f64,
    /// Repetition rate in hertz, if the motion were a sine.
    pub rate_hz: f64,
}

/// Switching frequency at evenly spaced times.
#[derive(Clone, Debug, PartialEq)]
pub struct Carrier {
    /// Time of the first value in seconds.
    pub(crate) t0_s: f64,
    /// Time from one value to the next in seconds, about a switching period.
    pub(crate) step_s: f64,
    /// Frequencies in hertz.
    pub(crate) f_hz: Vec<f64>,
    /// Weight of each value: the carrier's power as a share of the largest.
    weight: Vec<f64>,
    /// Periods from the first value to each.
    pub(crate) periods: Vec<f64>,
}

impl Carrier {
    /// Follows the carrier through a segment.
    pub fn from_segment(segment: &Segment) -> Option<Self> {
        Self::from_frames(&HannFrames::compute(segment)?)
    }

    /// Follows the carrier through evenly spaced samples of voltage and current, the first at `t0_s` seconds; `f_hz` is
    /// its frequency within a third. `None` if there are too few samples.
    pub fn follow<T: Copy + Into<f64>>(
        v_v: &[T],
        i_a: &[T],
        t0_s: f64,
        dt_s: f64,
        f_hz: f64,
    ) -> Option<Self> {
        Self::from_frames(&HannFrames::of_samples([v_v, i_a], (t0_s, dt_s, f_hz))?)
    }

    /// Follows the carrier from frame to frame; `None` if there are too few.
    pub fn from_frames(frames: &HannFrames) -> Option<Self> {
        let (f_hz, step_s) = (frames.f_hz, frames.step_s());
        let turns = frames.turns();
        if turns.len() < 4 {
            return None;
        }
        let largest = turns.iter().map(|z| z.norm()).fold(0.0, f64::max);
        if largest.is_nan() || largest <= 0.0 {
            return None;
        }
        let weight: Vec<f64> = turns.iter().map(|z| z.norm() / largest).collect();
        let off_hz: Vec<f64> = turns.iter().map(|z| z.arg() / (TAU * step_s)).collect();
        let stiffness = (TAU * CUT_OFF_HZ * step_s).powi(-4);
        let off_hz = smooth::whittaker(&off_hz, &weight, stiffness);
        // No carrier that can be demodulated is faster or slower than that.
        let f: Vec<f64> = off_hz
            .iter()
            .map(|off| f_hz + off.clamp(-f_hz / 3.0, f_hz / 3.0))
            .collect();
        let mut at = 0.0;
        let mut periods = vec![0.0];
        periods.extend(f.windows(2).map(|w| {
            at += 0.5 * (w[0] + w[1]) * step_s;
            at
        }));
        Some(Self {
            // Time between the middles of two frames.
            t0_s: frames.t0_s + 0.5 * (frames.length + frames.hop) as f64 * frames.dt_s,
            step_s,
            f_hz: f,
            weight,
            periods,
        })
    }

    /// Frequency in hertz at a time in seconds; constant before the first and after the last value.
    pub fn hz(&self, t_s: f64) -> f64 {
        let (k, w) = self.place(t_s);
        self.f_hz[k] + w.clamp(0.0, 1.0) * (self.f_hz[k + 1] - self.f_hz[k])
    }

    /// Periods since the first value: the integral of [`Carrier::hz`].
    pub fn periods(&self, t_s: f64) -> f64 {
        let (k, w) = self.place(t_s);
        let inside = w.clamp(0.0, 1.0);
        let (a, b) = (self.f_hz[k], self.f_hz[k + 1]);
        let linear = inside * (a + 0.5 * inside * (b - a));
        let beyond = (w - inside) * if w < 0.0 { a } else { b };
        self.periods[k] + (linear + beyond) * self.step_s
    }

    /// Index of the value before a time, and the share of the step after it; below 0 or above 1 beyond the ends.
    fn place(&self, t_s: f64) -> (usize, f64) {
        let at = (t_s - self.t0_s) / self.step_s;
        let k = (at.max(0.0) as usize).min(self.f_hz.len() - 2);
        (k, at - k as f64)
    }

    /// Mean in hertz, weighted with the carrier's power.
    pub fn mean_hz(&self) -> f64 {
        let sum: f64 = self.f_hz.iter().zip(&self.weight).map(|(f, w)| f * w).sum();
        sum / self.weight.iter().sum::<f64>()
    }

    /// Returns `true` if the carrier moves so much that time must be warped.
    pub fn moves(&self) -> bool {
        let mean = self.mean_hz();
        self.moves_from(|_| Some(mean))
    }

    /// Returns `true` if the carrier moves away from the frequency in hertz that is expected at each time in seconds; times
    /// with `None` are ignored.
    pub fn moves_from(&self, expected_hz: impl Fn(f64) -> Option<f64>) -> bool {
        let off: Vec<(f64, f64)> = (self.values())
            .filter_map(|(t_s, f, w)| Some(((f - expected_hz(t_s)?).abs(), w)))
            .collect();
        let share_beyond = |hz: f64| {
            let beyond: f64 = off.iter().filter(|o| o.0 > hz).map(|o| o.1).sum();
            beyond / off.iter().map(|o| o.1).sum::<f64>()
        };
        share_beyond(MOVES_HZ) > MAX_OFTEN || share_beyond(MOVES_FAR_HZ) > MAX_RARELY
    }

    /// Returns mean, deviation and rate of the motion.
    pub fn sweep(&self) -> Sweep {
        let mean_hz = self.mean_hz();
        let strong = || self.values().filter(|v| v.2 > MIN_POWER_SHARE);
        let mut f: Vec<f64> = strong().map(|v| v.1).collect();
        f.sort_by(f64::total_cmp);
        let rank = |share: f64| f.get((share * f.len() as f64) as usize).copied();
        let (low, high) = (rank(0.02).unwrap_or(mean_hz), rank(0.98).unwrap_or(mean_hz));
        let deviation_hz = 0.5 * (high - low);
        // The slope of a sine is 2π·rate times the deviation, both rms. Not weighted: with the mains' power some phases of
        // the sweep would count more, and the smoother's straight line through a zero crossing is accurate enough.
        let centre_hz = self.f_hz.iter().sum::<f64>() / self.f_hz.len() as f64;
        let off = self.f_hz.iter().map(|f| (f - centre_hz).powi(2));
        let slope = self.f_hz.windows(2);
        let slope = slope.map(|f| ((f[1] - f[0]) / self.step_s).powi(2));
        let off = off.sum::<f64>().max(f64::MIN_POSITIVE);
        let rate_hz = (slope.sum::<f64>() / off).sqrt() / TAU;
        Sweep {
            mean_hz,
            deviation_hz,
            rate_hz,
        }
    }

    /// Values in order of time: time in seconds, frequency in hertz, and the share of the largest power.
    pub fn values(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let pairs = self.f_hz.iter().zip(&self.weight).enumerate();
        pairs.map(|(k, (f, w))| (self.t0_s + k as f64 * self.step_s, *f, *w))
    }
}

#[cfg(test)]
mod tests;
