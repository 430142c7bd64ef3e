//! Truth of a waveform: impedance of the fundamental and of harmonics, period by period.

use std::f64::consts::TAU;

use nalgebra::Complex;

/// Harmonic orders of the switching frequency that are measured; a half-bridge has no even ones.
pub const ORDERS: [usize; 4] = [1, 3, 5, 7];

/// What one switching period shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodTruth {
    /// Middle of the period, in seconds.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// R of each order in ohm.
    pub r_ohm: [f64; ORDERS.len()],
    /// L of each order in henry.
    pub l_h: [f64; ORDERS.len()],
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
    /// Mean of v i over mean of i², in ohm.
    pub r_power_ohm: f64,
    /// Mean of v i in watt.
    pub p_w: f64,
}

/// Sums over one switching period.
///
/// V_h = R_h I_h + L_h D_h with D_h the phasor of di/dt. Over a whole period
/// D_h = jhω I_h + (2/T)(i(end) − i(start)), exactly: a growing or falling envelope does not
/// disturb R and L.
#[derive(Clone, Debug)]
pub struct PeriodMeter {
    turn: Vec<Complex<f64>>,
    v: [Complex<f64>; ORDERS.len()],
    i: [Complex<f64>; ORDERS.len()],
    power: f64,
    square: f64,
    i_start_a: f64,
}

impl PeriodMeter {
    /// For a period of `steps` integration steps.
    pub fn new(steps: usize) -> Self {
        let turn = (0..=steps)
            .map(|n| {
                let angle = TAU * (n % steps) as f64 / steps as f64;
                Complex::new(libm::cos(angle), -libm::sin(angle))
            })
            .collect();
        let zero = Complex::new(0.0, 0.0);
        Self {
            turn,
            v: [zero; ORDERS.len()],
            i: [zero; ORDERS.len()],
            power: 0.0,
            square: 0.0,
            i_start_a: 0.0,
        }
    }

    /// Takes coil voltage and current at boundary `n` of the period, 0 and `steps` included: the
    /// sum is the trapezoidal rule.
    pub fn push(&mut self, n: usize, v_v: f64, i_a: f64) {
        let steps = self.turn.len() - 1;
        let weight = if n == 0 || n == steps { 0.5 } else { 1.0 };
        if n == 0 {
            self.v = [Complex::new(0.0, 0.0); ORDERS.len()];
            self.i = self.v;
            (self.power, self.square, self.i_start_a) = (0.0, 0.0, i_a);
        }
        let (v, i) = (v_v * weight, i_a * weight);
        for (k, order) in ORDERS.into_iter().enumerate() {
            let turn = self.turn[order * n % steps];
            self.v[k] += turn * v;
            self.i[k] += turn * i;
        }
        self.power += v * i_a;
        self.square += i * i_a;
    }

    /// The period's truth, after the push of its last boundary; `t_s` is its middle.
    pub fn truth(&self, t_s: f64, f_sw_hz: f64, i_end_a: f64) -> PeriodTruth {
        let steps = (self.turn.len() - 1) as f64;
        let jump = (i_end_a - self.i_start_a) * 2.0 * f_sw_hz;
        let mut out = PeriodTruth {
            t_s,
            f_sw_hz,
            r_ohm: [0.0; ORDERS.len()],
            l_h: [0.0; ORDERS.len()],
            i_a: self.i[0].norm_sqr().sqrt() * 2.0 / steps,
            r_power_ohm: self.power / self.square,
            p_w: self.power / steps,
        };
        for (k, order) in ORDERS.into_iter().enumerate() {
            let (v, i) = (self.v[k] * (2.0 / steps), self.i[k] * (2.0 / steps));
            let rate = Complex::new(0.0, TAU * f_sw_hz * order as f64) * i + jump;
            // Two real equations in R and L.
            let determinant = i.re * rate.im - i.im * rate.re;
            out.r_ohm[k] = (v.re * rate.im - v.im * rate.re) / determinant;
            out.l_h[k] = (i.re * v.im - i.im * v.re) / determinant;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growing_current_through_a_constant_r_and_l_gives_both_back() {
        let (r, l, f, steps) = (3.0, 22e-6, 45e3, 1111);
        let mut meter = PeriodMeter::new(steps);
        let period = 1.0 / f;
        // i = a t sin ωt + b t cos 3ωt, 20 % growth within the period.
        let (w, t0) = (TAU * f, 4.0 * period);
        let (a, b) = (10.0 / t0, 2.0 / t0);
        let current = |t: f64| a * t * (w * t).sin() + b * t * (3.0 * w * t).cos();
        let rate = |t: f64| {
            a * (w * t).sin() + a * t * w * (w * t).cos() + b * (3.0 * w * t).cos()
                - 3.0 * b * t * w * (3.0 * w * t).sin()
        };
        for n in 0..=steps {
            let t = t0 + period * n as f64 / steps as f64;
            meter.push(n, r * current(t) + l * rate(t), current(t));
        }
        let truth = meter.truth(t0 + period / 2.0, f, current(t0 + period));
        for k in [0, 1] {
            assert!(
                (truth.r_ohm[k] / r - 1.0).abs() < 1e-4,
                "R {}",
                truth.r_ohm[k]
            );
            assert!((truth.l_h[k] / l - 1.0).abs() < 1e-4, "L {}", truth.l_h[k]);
        }
        assert!((truth.i_a - 10.0 * 4.5 / 4.0).abs() < 0.3);
    }
}
