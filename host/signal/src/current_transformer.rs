//! Droop of a current transformer: its secondary lacks the magnetising current, a first-order low pass of the primary's.
//!
//! At f_sw the current leads by 1/(ωτ), some tenths of a milliradian. With L of a coil that is R by L/τ too large: 0.2 % of a
//! pot's, 4 % of the bare coil's. A voltage with the same droop leaves R, L and the power as they are.

use ihd_shared::sampling::CURRENT_TRANSFORMER_TAU_US;

use crate::{Capture, Segment};

/// Key of a capture's metadata whose current is as a board's transformer shows it: the transformer's time constant in microseconds.
pub const METADATA_KEY: &str = "current_transformer_tau_us";

/// Returns the time constant in seconds of the transformer whose droop a capture's current has; `None` if it has none.
pub fn tau_s(capture: &Capture) -> Option<f64> {
    let tau_us: f64 = capture.metadata.get(METADATA_KEY)?.parse().ok()?;
    (tau_us.is_finite() && tau_us > 0.0).then_some(1e-6 * tau_us)
}

/// Returns the entry of [`METADATA_KEY`] for what this build's board samples.
pub fn metadata_entry() -> (String, String) {
    let tau_us = CURRENT_TRANSFORMER_TAU_US.to_string();
    (METADATA_KEY.to_owned(), tau_us)
}

/// Time constant of this build's board, in seconds.
pub const BOARD_TAU_S: f64 = 1e-6 * CURRENT_TRANSFORMER_TAU_US as f64;

/// Applies the droop of a transformer to evenly spaced values, `dt_s` seconds apart, from rest.
pub fn droop(x: &mut [f64], dt_s: f64, tau_s: f64) {
    // Trapezoidal, as 20 samples a period allow: 0.8 % of the droop.
    let half_step = 0.5 * dt_s / tau_s;
    let keep = (1.0 - half_step) / (1.0 + half_step);
    let gain = half_step / (1.0 + half_step);
    let (mut before, mut magnetising) = (0.0, 0.0);
    for x in x {
        magnetising = keep * magnetising + gain * (before + *x);
        before = *x;
        *x -= magnetising;
    }
}

/// Returns a segment of true coil currents as this build's board samples it.
#[must_use]
pub fn sampled(segment: &Segment) -> Segment {
    let mut i_a = segment.i_a.to_vec();
    droop(&mut i_a, segment.dt_s, BOARD_TAU_S);
    segment.with_samples(segment.v_v.to_vec(), i_a)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A coil of R and L behind the board's transformer, with the voltage made equal: phasors of 100 whole periods.
    #[test]
    fn a_voltage_with_the_same_droop_leaves_the_load() {
        let (f_hz, r_ohm, l_h) = (34e3, 0.1, 50e-6);
        let dt_s = 3.0 / (61.0 * f_hz);
        let omega = TAU * f_hz;
        let n = 61 * 100;
        let wave = |of: &dyn Fn(f64) -> f64| (0..n).map(|k| of(omega * dt_s * k as f64)).collect();
        let mut i_a: Vec<f64> = wave(&|phase| phase.cos());
        let mut v_v: Vec<f64> = wave(&|phase| r_ohm * phase.cos() - omega * l_h * phase.sin());
        let load = |v_v: &[f64], i_a: &[f64]| {
            let phasor = |x: &[f64]| {
                let turned = |(k, x): (usize, &f64)| {
                    let (sin, cos) = (omega * dt_s * k as f64).sin_cos();
                    nalgebra::Complex::new(x * cos, -x * sin)
                };
                x.iter()
                    .enumerate()
                    .map(turned)
                    .sum::<nalgebra::Complex<f64>>()
            };
            let z = phasor(v_v) / phasor(i_a);
            (z.re, z.im / omega)
        };
        droop(&mut i_a, dt_s, BOARD_TAU_S);
        // R + L/τ: 50 µH / 11.236 ms are 4.45 mΩ.
        let (seen_ohm, _) = load(&v_v, &i_a);
        assert!((seen_ohm - 0.10445).abs() < 5e-5, "{seen_ohm}");
        droop(&mut v_v, dt_s, BOARD_TAU_S);
        let (r, l) = load(&v_v, &i_a);
        assert!((r / r_ohm - 1.0).abs() < 2e-4, "{r}");
        assert!((l / l_h - 1.0).abs() < 1e-6, "{l}");
    }
}
