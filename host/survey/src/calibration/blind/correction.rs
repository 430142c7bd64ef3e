//! Correction of a sensor's fault by applying the same fault to the other channel.
//!
//! A response that both channels share changes neither R nor L, and unlike its inverse it amplifies no noise. Filters are
//! applied in the frequency domain, because at 20 samples per period a recursion in time has an error of a percent.

use std::f64::consts::TAU;

use ihd_signal::Capture;
use ihd_signal::fourier;
use ihd_signal::segment::Segment;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use super::super::delay::delay;
use crate::time::runs;

/// Filters that make two channels equal; all zero if there is nothing to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Correction {
    /// Time by which the current is sampled later than the voltage, in seconds; the current is shifted by it.
    pub skew_s: f64,
    /// Time constant of the current's first-order low-pass in seconds, which is applied to the voltage.
    pub i_tau_s: f64,
    /// Time constant of the voltage's first-order low-pass in seconds, which is applied to the current.
    pub v_tau_s: f64,
    /// Corner of the current's first-order high-pass in hertz, which is applied to the voltage.
    pub i_droop_hz: f64,
}

impl Correction {
    /// Returns `true` if there is nothing to do.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Equalises the channels of a capture, run by run.
    pub fn apply(&self, capture: &mut Capture) {
        if self.is_none() {
            return;
        }
        for run in runs(capture, &mut Vec::new()) {
            let (Some(v), Some(i)) = (
                capture.v_v.get_mut(run.samples.clone()),
                capture.i_a.get_mut(run.samples.clone()),
            ) else {
                continue;
            };
            let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect();
            let (mut v_v, mut i_a): (Vec<f64>, Vec<f64>) = (wide(v), wide(i));
            self.filter(&mut v_v, &mut i_a, run.dt_s);
            for (to, from) in [(v, v_v), (&mut *i, i_a)] {
                to.iter_mut().zip(from).for_each(|(to, x)| *to = x as f32);
            }
            delay(i, self.skew_s / run.dt_s);
        }
        capture
            .metadata
            .insert("self_calibration".to_owned(), self.to_string());
    }

    /// Returns a segment with equalised channels.
    #[must_use]
    pub fn applied(&self, segment: &Segment) -> Segment {
        let (mut v_v, mut i_a) = (segment.v_v.to_vec(), segment.i_a.to_vec());
        self.filter(&mut v_v, &mut i_a, segment.dt_s);
        let mut late: Vec<f32> = i_a.iter().map(|x| *x as f32).collect();
        if self.skew_s != 0.0 {
            delay(&mut late, self.skew_s / segment.dt_s);
            i_a = late.into_iter().map(f64::from).collect();
        }
        segment.with_samples(v_v, i_a)
    }

    pub(super) fn filter(&self, v_v: &mut [f64], i_a: &mut [f64], dt_s: f64) {
        let low = |omega: f64, tau_s: f64| Complex::from(1.0) / Complex::new(1.0, omega * tau_s);
        let corner = TAU * self.i_droop_hz;
        if self.i_tau_s > 0.0 || self.i_droop_hz > 0.0 {
            let memory_s = (self.i_tau_s).max(if corner > 0.0 { 1.0 / corner } else { 0.0 });
            filtered(v_v, dt_s, memory_s, |omega| {
                let high = match corner > 0.0 {
                    true => Complex::new(0.0, omega) / Complex::new(corner, omega),
                    false => Complex::from(1.0),
                };
                low(omega, self.i_tau_s) * high
            });
        }
        if self.v_tau_s > 0.0 {
            filtered(i_a, dt_s, self.v_tau_s, |omega| low(omega, self.v_tau_s));
        }
    }
}

impl std::fmt::Display for Correction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let khz = |tau_s: f64| 1e-3 / (TAU * tau_s);
        let mut parts = Vec::new();
        if self.skew_s != 0.0 {
            parts.push(format!("current delayed by {:.1} ns", self.skew_s * 1e9));
        }
        if self.i_tau_s > 0.0 {
            let (khz, ns) = (khz(self.i_tau_s), self.i_tau_s * 1e9);
            parts.push(format!(
                "voltage given the current's bandwidth of {khz:.4} kHz ({ns:.1} ns)"
            ));
        }
        if self.v_tau_s > 0.0 {
            let (khz, ns) = (khz(self.v_tau_s), self.v_tau_s * 1e9);
            parts.push(format!(
                "current given the voltage's bandwidth of {khz:.4} kHz ({ns:.1} ns)"
            ));
        }
        if self.i_droop_hz > 0.0 {
            parts.push(format!(
                "voltage given the current's droop of {:.0} Hz",
                self.i_droop_hz
            ));
        }
        f.write_str(&parts.join(", "))
    }
}

/// Time constants, and least samples, by which the ends are extended.
const PADDING: f64 = 12.0;
const PADDING_SAMPLES: usize = 64;

/// Filters by a transfer function of the angular frequency. Both ends are extended by mirror images, without a step.
fn filtered(x: &mut [f64], dt_s: f64, memory_s: f64, transfer: impl Fn(f64) -> Complex<f64>) {
    let n = x.len();
    if n < 2 {
        return;
    }
    let pad = ((PADDING * memory_s / dt_s) as usize + PADDING_SAMPLES).min(4 * n);
    let length = smooth_length(n + 2 * pad);
    // Mirrored at both ends, repeatedly if needed.
    let mirrored = |k: usize| {
        let period = 2 * (n - 1);
        let at = (k as i64 - pad as i64).rem_euclid(period as i64) as usize;
        x[at.min(period - at)]
    };
    let mut padded: Vec<f64> = (0..length).map(mirrored).collect();
    let forward = fourier::forward(length);
    let inverse = fourier::inverse(length);
    let mut spectrum = forward.make_output_vec();
    if forward.process(&mut padded, &mut spectrum).is_err() {
        return;
    }
    let scale = 1.0 / length as f64;
    let last = spectrum.len() - 1;
    for (k, value) in spectrum.iter_mut().enumerate() {
        let omega = TAU * k as f64 / (length as f64 * dt_s);
        *value *= transfer(omega) * scale;
        // The first and last bin of a real signal have no imaginary part.
        if k == 0 || (k == last && length.is_multiple_of(2)) {
            value.im = 0.0;
        }
    }
    if inverse.process(&mut spectrum, &mut padded).is_ok() {
        x.copy_from_slice(&padded[pad..pad + n]);
    }
}

/// Smallest length of at least `least` whose transform is fast.
fn smooth_length(least: usize) -> usize {
    let is_smooth = |mut n: usize| {
        for p in [2, 3, 5] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    (least..).find(|n| is_smooth(*n)).unwrap_or(least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_do_to_a_sine_what_their_formula_says() {
        // 20 and 1250 samples a period.
        for (dt_s, n) in [(1e-6, 4_000), (16e-9, 240_000)] {
            let omega = TAU * 50e3;
            let sine = |k: usize| (omega * k as f64 * dt_s + 0.4).sin();
            let correction = Correction {
                i_tau_s: 1.59e-6,
                v_tau_s: 0.3e-6,
                i_droop_hz: 1e3,
                ..Correction::default()
            };
            let mut v: Vec<f64> = (0..n).map(sine).collect();
            let mut i = v.clone();
            correction.filter(&mut v, &mut i, dt_s);
            let low = |tau_s: f64| Complex::from(1.0) / Complex::new(1.0, omega * tau_s);
            let high = Complex::new(0.0, omega) / Complex::new(TAU * 1e3, omega);
            for k in n / 3..n / 2 {
                let turned =
                    |h: Complex<f64>| h.norm() * (omega * k as f64 * dt_s + 0.4 + h.arg()).sin();
                assert!(
                    (v[k] - turned(low(1.59e-6) * high)).abs() < 1e-3,
                    "{dt_s} {k}"
                );
                assert!((i[k] - turned(low(0.3e-6))).abs() < 1e-3, "{dt_s} {k}");
            }
        }
    }

    #[test]
    fn nothing_and_short_ones_pass() {
        let mut v = vec![1.0, 2.0, 3.0];
        Correction::default().filter(&mut v, &mut [], 1e-6);
        assert_eq!(v, [1.0, 2.0, 3.0]);
        let slow = Correction {
            i_tau_s: 1e-3,
            ..Correction::default()
        };
        let mut one = [1.0];
        slow.filter(&mut one, &mut [], 1e-6);
        slow.filter(&mut [], &mut [], 1e-6);
        slow.filter(&mut v, &mut [], 1e-6);
        assert!(v.iter().all(|x| x.is_finite()));
    }
}
