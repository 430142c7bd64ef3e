//! What R(t) and L(t) imply for the waveforms: the fit quality of estimators that have none of their
//! own.
//!
//! The current is what eq. (1) gives when the measured voltage drives it; the voltage is R·i + L·di/dt
//! with the measured current as harmonics of f_sw up to the 31st, window by window, so that nothing
//! is differentiated sample by sample.

use std::f64::consts::TAU;

use ihd_signal::Segment;
use ihd_signal::correlation::Correlator;
use nalgebra::Complex;

use super::Estimate;
use super::lockin::Boxcar;
use super::trajectory::Trajectory;

/// Odd harmonics 1 to 31: the paper's NMSE of the voltage needs about that many.
const ORDERS: usize = 16;

/// Fills in the waveforms that the estimator has not reconstructed itself, and the errors of all.
/// An estimate without points is left as it is.
pub fn complete(segment: &Segment, estimate: &mut Estimate) {
    let Some(trajectory) = Trajectory::from(estimate, f64::NEG_INFINITY) else {
        return;
    };
    let lacks = |x: &[f32]| x.len() != segment.len();
    let current = lacks(&estimate.i_hat_a).then(|| driven_current(segment, trajectory));
    let voltage = lacks(&estimate.v_hat_v).then(|| harmonic_voltage(segment, trajectory));
    if let Some(i_hat_a) = current {
        estimate.i_hat_a = i_hat_a;
    }
    if let Some(v_hat_v) = voltage {
        estimate.v_hat_v = v_hat_v;
    }
    let range = covered(segment, estimate);
    estimate.nmse_v_pct = nmse_pct(
        &estimate.v_hat_v[range.clone()],
        &segment.v_v[range.clone()],
    );
    estimate.nmse_i_pct = nmse_pct(&estimate.i_hat_a[range.clone()], &segment.i_a[range]);
}

/// The samples for which there is an estimate.
fn covered(segment: &Segment, estimate: &Estimate) -> std::ops::Range<usize> {
    let index = |t_s: f64| ((t_s - segment.t0_s) / segment.dt_s).round().max(0.0) as usize;
    let first = estimate.t_s.first().map_or(0, |t| index(*t));
    let last = estimate.t_s.last().map_or(0, |t| index(*t) + 1);
    let last = last.min(segment.len());
    first.min(last)..last
}

/// Σ(x̂ − x)²/Σx² in percent; `None` where there is nothing or no finite number.
fn nmse_pct(found: &[f32], right: &[f64]) -> Option<f64> {
    let error: f64 = found
        .iter()
        .zip(right)
        .map(|(a, b)| (f64::from(*a) - b).powi(2))
        .sum();
    let nmse = 100.0 * error / right.iter().map(|x| x * x).sum::<f64>();
    nmse.is_finite().then_some(nmse)
}

/// The current through R(t) and L(t) at the measured voltage, by the trapezoidal rule.
fn driven_current(segment: &Segment, mut trajectory: Trajectory<'_>) -> Vec<f32> {
    let mut i = segment.i_a[0];
    let mut found = Vec::with_capacity(segment.len());
    found.push(i as f32);
    for k in 1..segment.len() {
        let (r, l) = trajectory.r_l(segment.t_s(k) - 0.5 * segment.dt_s);
        let (inertia, half) = (l / segment.dt_s, 0.5 * r);
        let v = 0.5 * (segment.v_v[k - 1] + segment.v_v[k]);
        i = (i * (inertia - half) + v) / (inertia + half);
        found.push(i as f32);
    }
    found
}

/// R·i + L·di/dt with the current's harmonics, in windows of a whole number of switching periods.
fn harmonic_voltage(segment: &Segment, mut trajectory: Trajectory<'_>) -> Vec<f32> {
    let per_period = segment.samples_per_period();
    let length = Boxcar::fitting(per_period, segment.f_sw_hz, 1.0 / segment.f_sw_hz).samples();
    let orders: [f64; ORDERS] = std::array::from_fn(|k| (2 * k + 1) as f64);
    let correlator = Correlator::new(segment, length, orders);
    let omega = TAU * segment.f_sw_hz;
    let mut found = vec![0.0; segment.len()];
    let windows = segment.v_v.chunks(length).zip(segment.i_a.chunks(length));
    let mut phasors = [Complex::new(0.0, 0.0); ORDERS];
    for (k, (v, i)) in windows.enumerate() {
        let first = k * length;
        if i.len() == length {
            let sums = correlator.block(first, v, i);
            let middle_s = segment.t_s(first) + 0.5 * length as f64 * segment.dt_s;
            let (r, l) = trajectory.r_l(middle_s);
            for (h, phasor) in phasors.iter_mut().enumerate() {
                let seen = 2.0 * orders[h] < per_period;
                let share = if seen { 2.0 / length as f64 } else { 0.0 };
                *phasor = sums.i[h] * share * Complex::new(r, orders[h] * omega * l);
            }
        }
        correlator.synthesise(first, &phasors, &mut found[first..first + i.len()]);
    }
    found
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
            v_v: wave(&|h| Complex::new(r, TAU * f * h * l)),
            i_a: wave(&|_| Complex::new(1.0, 0.0)),
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
