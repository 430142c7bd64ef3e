//! Waveforms that R(t) and L(t) imply, as a measure of fit for estimators without waveforms of their own.
//!
//! The current follows from eq. (1) with the measured voltage. The voltage is R·i + L·di/dt with the
//! measured current as harmonics of f_sw up to the 31st, window by window, so that nothing
//! is differentiated sample by sample.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::vectorised::{dot, vectorised};
use ihd_signal::{Samples, Segment};
use nalgebra::Complex;

use super::Estimate;
use super::centred_harmonics::CentredHarmonics;
use super::lockin::{Boxcar, for_chunks};
use super::trajectory::TrajectoryCursor;

/// Number of odd harmonics, 1 to 31: the paper's NMSE of the voltage needs about that many.
const ORDERS: usize = 16;

/// Samples that are compared together.
const PART: usize = 256;

/// Adds the waveforms that the estimator has not reconstructed itself, and the errors of all.
/// An estimate without points is left unchanged.
pub fn complete(segment: &Segment, estimate: &mut Estimate) {
    let Some(trajectory) = TrajectoryCursor::from(estimate, f64::NEG_INFINITY) else {
        return;
    };
    let lacks = |x: &[f32]| x.len() != segment.len();
    let (mut current, mut voltage) = (None, None);
    if lacks(&estimate.i_hat_a) {
        let all = current.insert(Vec::with_capacity(segment.len()));
        driven_current(segment, trajectory, |_, estimated, _| {
            all.extend_from_slice(estimated)
        });
    }
    if lacks(&estimate.v_hat_v) {
        let all = voltage.insert(Vec::with_capacity(segment.len()));
        harmonic_voltage(segment, trajectory, |_, estimated, _| {
            all.extend_from_slice(estimated)
        });
    }
    estimate.i_hat_a = current.unwrap_or_else(|| std::mem::take(&mut estimate.i_hat_a));
    estimate.v_hat_v = voltage.unwrap_or_else(|| std::mem::take(&mut estimate.v_hat_v));
    errors(segment, estimate);
}

/// Adds the errors of the waveforms that R(t) and L(t) imply, without keeping those waveforms: for a second at 50 MS/s they
/// take 400 MB.
pub fn errors(segment: &Segment, estimate: &mut Estimate) {
    let Some(trajectory) = TrajectoryCursor::from(estimate, f64::NEG_INFINITY) else {
        return;
    };
    let range = covered(segment, estimate);
    let (mut v, mut i) = (Nmse::over(range.clone()), Nmse::over(range));
    if estimate.i_hat_a.len() == segment.len() {
        i.add_all(&estimate.i_hat_a, &segment.i_a);
    } else {
        driven_current(segment, trajectory, |first, estimated, right| {
            i.add(first, estimated, right)
        });
    }
    if estimate.v_hat_v.len() == segment.len() {
        v.add_all(&estimate.v_hat_v, &segment.v_v);
    } else {
        harmonic_voltage(segment, trajectory, |first, estimated, right| {
            v.add(first, estimated, right)
        });
    }
    (estimate.nmse_v_pct, estimate.nmse_i_pct) = (v.pct(), i.pct());
}

/// Range of samples for which there is an estimate.
fn covered(segment: &Segment, estimate: &Estimate) -> Range<usize> {
    let first = estimate.t_s.first().map_or(0, |t| segment.index_at(*t));
    let last = estimate.t_s.last().map_or(0, |t| segment.index_at(*t) + 1);
    let last = last.min(segment.len());
    first.min(last)..last
}

/// Σ(x̂ − x)²/Σx² over a range of samples.
struct Nmse {
    range: Range<usize>,
    error: f64,
    square: f64,
}

impl Nmse {
    fn over(range: Range<usize>) -> Self {
        Self {
            range,
            error: 0.0,
            square: 0.0,
        }
    }

    /// Adds samples from index `first` on.
    fn add(&mut self, first: usize, estimated: &[f32], right: &[f64]) {
        let within = |k: usize| k.clamp(first, first + estimated.len()) - first;
        let range = within(self.range.start)..within(self.range.end);
        let estimated = estimated[range.clone()].chunks(PART);
        let mut parts = estimated.zip(right[range].chunks(PART));
        let (mut error, mut sums) = ([0.0; PART], [0.0; 2]);
        vectorised(
            #[inline(always)]
            || {
                for (estimated, right) in parts.by_ref() {
                    let error = &mut error[..right.len()];
                    for (error, (estimated, right)) in
                        error.iter_mut().zip(estimated.iter().zip(right))
                    {
                        *error = f64::from(*estimated) - right;
                    }
                    sums[0] += dot(error, error);
                    sums[1] += dot(right, right);
                }
            },
        );
        self.error += sums[0];
        self.square += sums[1];
    }

    fn add_all(&mut self, estimated: &[f32], right: &Samples) {
        let mut buffer = Vec::new();
        for first in (0..estimated.len()).step_by(Samples::CHUNK) {
            let range = first..(first + Samples::CHUNK).min(estimated.len());
            self.add(
                first,
                &estimated[range.clone()],
                right.block(range, &mut buffer),
            );
        }
    }

    /// NMSE in percent; `None` if there are no samples, or the result is not finite.
    fn pct(&self) -> Option<f64> {
        let nmse = 100.0 * self.error / self.square;
        nmse.is_finite().then_some(nmse)
    }
}

/// Computes the current through R(t) and L(t) at the measured voltage by the trapezoidal rule; `sink` receives it in stretches,
/// with the index of the first sample and the measured current.
fn driven_current(
    segment: &Segment,
    mut trajectory: TrajectoryCursor<'_>,
    mut sink: impl FnMut(usize, &[f32], &[f64]),
) {
    let (mut last, mut before) = (None, 0.0);
    let mut current = Vec::with_capacity(Samples::CHUNK);
    let mut steps = Steps::new(segment.dt_s);
    for_chunks(segment, Samples::CHUNK, |first, v_v, i_a| {
        current.clear();
        if last.is_none() {
            (last, before) = (Some(i_a[0]), v_v[0]);
            current.push(i_a[0] as f32);
        }
        while current.len() < v_v.len() {
            let from = current.len();
            let t_s = segment.t_s(first + from) - 0.5 * segment.dt_s;
            let count = steps.compute(&mut trajectory, t_s, before, &v_v[from..]);
            before = v_v[from + count - 1];
            last = last.map(|at| steps.take(count, at, &mut current));
        }
        sink(first, &current, i_a);
    });
}

/// Steps of the current from sample to sample, i = decay·i + driven.
struct Steps {
    dt_s: f64,
    r_ohm: [f64; PART],
    l_h: [f64; PART],
    decay: [f64; PART],
    driven: [f64; PART],
}

impl Steps {
    fn new(dt_s: f64) -> Self {
        let [r_ohm, l_h, decay, driven] = [[0.0; PART]; 4];
        Self {
            dt_s,
            r_ohm,
            l_h,
            decay,
            driven,
        }
    }

    /// Computes steps by the trapezoidal rule, the middle of the first one at `t_s` seconds, from the voltage before it and those at the
    /// ends of the steps; returns how many.
    fn compute(
        &mut self,
        trajectory: &mut TrajectoryCursor<'_>,
        t_s: f64,
        before: f64,
        v_v: &[f64],
    ) -> usize {
        let most = v_v.len().min(PART);
        let loads = [&mut self.r_ohm[..most], &mut self.l_h[..most]];
        let count = trajectory.fill(t_s, self.dt_s, loads);
        let rate_hz = 1.0 / self.dt_s;
        let v_v = &v_v[..count];
        vectorised(
            #[inline(always)]
            || {
                let steps = self.decay[..count].iter_mut().zip(&mut self.driven);
                for ((decay, driven), (r, l)) in steps.zip(self.r_ohm.iter().zip(&self.l_h)) {
                    let (inertia, half) = (l * rate_hz, 0.5 * r);
                    let share = 1.0 / (inertia + half);
                    (*decay, *driven) = ((inertia - half) * share, 0.5 * share);
                }
                self.driven[0] *= before + v_v[0];
                for (driven, v) in self.driven[1..count].iter_mut().zip(v_v.windows(2)) {
                    *driven *= v[0] + v[1];
                }
            },
        );
        count
    }

    /// Takes so many steps from a current in ampere, appends where they lead, and returns the last.
    fn take(&self, count: usize, mut i_a: f64, current: &mut Vec<f32>) -> f64 {
        let (decay, decay_rest) = self.decay[..count].as_chunks::<4>();
        let (driven, driven_rest) = self.driven[..count].as_chunks::<4>();
        // Four steps as functions of the current before the first, so that only the last of them waits for it.
        for (&[a, b, c, d], &[p, q, r, s]) in decay.iter().zip(driven) {
            let (ab, pq) = (a * b, b * p + q);
            let (abc, pqr) = (ab * c, c * pq + r);
            let (all, driven) = (abc * d, d * pqr + s);
            let four = [
                a * i_a + p,
                ab * i_a + pq,
                abc * i_a + pqr,
                all * i_a + driven,
            ];
            current.extend(four.map(|i| i as f32));
            i_a = four[3];
        }
        for (decay, driven) in decay_rest.iter().zip(driven_rest) {
            i_a = decay * i_a + driven;
            current.push(i_a as f32);
        }
        i_a
    }
}

/// Computes R·i + L·di/dt with the current's harmonics, in windows of a whole number of switching periods; `sink` receives it
/// in stretches, with the index of the first sample and the measured voltage.
fn harmonic_voltage(
    segment: &Segment,
    mut trajectory: TrajectoryCursor<'_>,
    mut sink: impl FnMut(usize, &[f32], &[f64]),
) {
    let per_period = segment.samples_per_period();
    let length = Boxcar::of_periods(segment, 1.0).samples();
    let orders: [f64; ORDERS] = std::array::from_fn(|k| (2 * k + 1) as f64);
    let windows = CentredHarmonics::new(segment.f_sw_hz * segment.dt_s, length, orders);
    let omega = TAU * segment.f_sw_hz;
    let mut voltage = vec![0.0; length];
    let mut phasors = [Complex::new(0.0, 0.0); ORDERS];
    for_chunks(segment, length, |first, v, i| {
        if i.len() == length {
            let sums = windows.sums(first, i);
            let middle_s = segment.t_s(first) + 0.5 * length as f64 * segment.dt_s;
            let (r, l) = trajectory.r_l(middle_s);
            for (h, phasor) in phasors.iter_mut().enumerate() {
                let seen = 2.0 * orders[h] < per_period;
                let share = if seen { 2.0 / length as f64 } else { 0.0 };
                *phasor = sums[h] * share * Complex::new(r, orders[h] * omega * l);
            }
        }
        windows.synthesise(first, &phasors, &mut voltage);
        sink(first, &voltage[..i.len()], v);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Method;

    /// A constant load, its exact steady state with three harmonics.
    fn steady(r: f64, l: f64) -> Segment {
        let (f, n) = (50e3, 5000);
        let dt_s = 1.0 / (f * 250.0);
        let wave = |scale: &dyn Fn(f64) -> Complex<f64>| -> Vec<f64> {
            (0..n)
                .map(|k| {
                    let part = |h: f64| {
                        let turn = Complex::from_polar(1.0, TAU * f * h * k as f64 * dt_s);
                        (scale(h) * turn * (20.0 / (h * h))).re
                    };
                    part(1.0) + part(3.0) + part(5.0)
                })
                .collect()
        };
        Segment {
            f_sw_hz: f,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s,
            v_v: wave(&|h| Complex::new(r, TAU * f * h * l)).into(),
            i_a: wave(&|_| Complex::new(1.0, 0.0)).into(),
        }
    }

    #[test]
    fn the_right_load_reconstructs_both_waveforms_and_a_wrong_one_does_not() {
        let segment = steady(4.0, 20e-6);
        let with = |r: f64, l: f64| {
            let mut estimate = Estimate::new(Method::Lockin, segment.f_sw_hz);
            for k in 0..100 {
                estimate.push(k as f64 * 4e-6, (r, l), (0.0, 0.0));
            }
            complete(&segment, &mut estimate);
            (estimate.nmse_v_pct.unwrap(), estimate.nmse_i_pct.unwrap())
        };
        let (v, i) = with(4.0, 20e-6);
        assert!(v < 1e-4 && i < 1e-2, "{v} {i}");
        // 10 % too much L: the fundamental's voltage is off by 10 % of ωL in |Z|, so 0.7 % NMSE.
        let (v, i) = with(4.0, 22e-6);
        assert!((0.5..1.0).contains(&v) && i > 0.5, "{v} {i}");
    }
}
