//! The f64 twins of the firmware's demodulator and filter, written from the equations in matrix
//! form and sharing no code with them.

use std::f64::consts::TAU;

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, AMPERE_PER_CODE, Pair, VOLT_PER_CODE};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Matrix4x2, Vector2, Vector4};

/// A phasor as (real, imaginary), amplitude.
pub type Phasor = (f64, f64);

/// Phasors (V, I) of the fundamental per block: correlation with e^(−jθ), then two boxcars of 0.2 ms,
/// as one convolution with their triangle. Entry k belongs to the centre of block k + N − 1.
pub fn demodulate(blocks: &[[Pair; ADC_LOCK_P]], f_sw_hz: u32) -> (usize, Vec<(Phasor, Phasor)>) {
    let n = (0.2e-3 * f64::from(f_sw_hz) / f64::from(ADC_LOCK_Q)).round() as usize;
    let correlate = |block: &[Pair; ADC_LOCK_P], value: fn(&Pair) -> f64| -> Phasor {
        let mut sum = (0.0, 0.0);
        for (k, pair) in block.iter().enumerate() {
            let angle = TAU * f64::from(ADC_LOCK_Q) * k as f64 / ADC_LOCK_P as f64;
            sum.0 += value(pair) * angle.cos() * 2.0 / ADC_LOCK_P as f64;
            sum.1 -= value(pair) * angle.sin() * 2.0 / ADC_LOCK_P as f64;
        }
        sum
    };
    let raw: Vec<[f64; 4]> = blocks
        .iter()
        .map(|b| {
            let v = correlate(b, |p| f64::from(p.v) * VOLT_PER_CODE);
            let i = correlate(b, |p| f64::from(p.i) * AMPERE_PER_CODE);
            [v.0, v.1, i.0, i.1]
        })
        .collect();
    let triangle: Vec<f64> = (0..2 * n - 1)
        .map(|k| (n as f64 - (k as f64 - (n as f64 - 1.0)).abs()) / (n * n) as f64)
        .collect();
    let smooth = |at: usize| -> (Phasor, Phasor) {
        let mut s = [0.0; 4];
        for (w, block) in triangle.iter().zip(&raw[at..]) {
            for (s, x) in s.iter_mut().zip(block) {
                *s += w * x;
            }
        }
        ((s[0], s[1]), (s[2], s[3]))
    };
    let outputs = (raw.len() + 1).saturating_sub(2 * n - 1);
    (n - 1, (0..outputs).map(smooth).collect())
}

/// Derivative of the current's prediction by X.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jacobian {
    /// The firmware's: L/dt = κX is taken as known, so that I' is analytic in I and R + jX.
    Analytic,
    /// With the term κ(I − I')/D that L/dt contributes.
    Exact,
}

/// The filter of `ihd_firmware::estimate::ekf` in f64: four real states (I_re, I_im, R, X), full matrices,
/// Joseph's form.
pub struct Ekf {
    /// State in A, A, ohm, ohm.
    pub x: Vector4<f64>,
    /// Covariance.
    pub p: Matrix4<f64>,
    omega: f64,
    held: bool,
    jacobian: Jacobian,
}

/// Variance of one current component: (50 mA)².
const MEASUREMENT: f64 = 0.05 * 0.05;
/// Process variance of one current component per step: (20 mA)².
const CURRENT: f64 = 0.02 * 0.02;
/// Process variance of R and X per step at large current: (10 mohm)².
const IMPEDANCE: f64 = 0.01 * 0.01;
/// The share that grows as the current falls, times |I|²: (0.6 V)².
const IMPEDANCE_BY_CURRENT: f64 = 0.6 * 0.6;
/// Variance at which R and X are capped: (1 ohm)².
const CEILING: f64 = 1.0;
/// Floor of the variance of R and X, in ohm².
const FLOOR: f64 = 1e-5;
/// Time constant of the current transformer in seconds: 80 mH over 7.12 ohm. R appears larger by L over it.
const TRANSFORMER_S: f64 = 0.08 / 7.12;

impl Ekf {
    /// A filter that expects R in ohm and L in henry.
    pub fn new(f_sw_hz: u32, r_ohm: f64, l_h: f64, jacobian: Jacobian) -> Self {
        let omega = TAU * f64::from(f_sw_hz);
        Self {
            x: Vector4::new(0.0, 0.0, r_ohm + l_h / TRANSFORMER_S, omega * l_h),
            p: Matrix4::from_diagonal(&Vector4::new(MEASUREMENT, MEASUREMENT, CEILING, CEILING)),
            omega,
            held: true,
            jacobian,
        }
    }

    /// R in ohm and L in henry.
    pub fn r_l(&self) -> (f64, f64) {
        let l_h = self.x[3] / self.omega;
        (self.x[2] - l_h / TRANSFORMER_S, l_h)
    }

    /// One block: V known, I measured, in volt and ampere.
    pub fn step(&mut self, v: Phasor, i: Phasor) {
        let z = Vector2::new(i.0, i.1);
        if z.norm_squared() < 1.0 {
            let tt = self.p.fixed_view::<2, 2>(2, 2).into_owned();
            self.p = Matrix4::zeros();
            self.p.fixed_view_mut::<2, 2>(2, 2).copy_from(&tt);
            self.p[(0, 0)] = MEASUREMENT;
            self.p[(1, 1)] = MEASUREMENT;
            self.x.fixed_rows_mut::<2>(0).copy_from(&z);
            self.held = true;
            return;
        }
        if self.held {
            self.x.fixed_rows_mut::<2>(0).copy_from(&z);
            self.held = false;
        }
        self.predict(Vector2::new(v.0, v.1), z.norm_squared());
        let h = Matrix2x4::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
        let noise = Matrix2::identity() * MEASUREMENT;
        let s = h * self.p * h.transpose() + noise;
        let k: Matrix4x2<f64> = self.p * h.transpose() * s.try_inverse().expect("S ≥ r > 0");
        self.x += k * (z - h * self.x);
        let rest = Matrix4::identity() - k * h;
        self.p = rest * self.p * rest.transpose() + k * noise * k.transpose();
        for d in [2, 3] {
            self.p[(d, d)] = self.p[(d, d)].max(FLOOR);
        }
    }

    /// L dI/dt = V − (R + jωL) I by the backward difference over dt = q/f_sw, solved as a real
    /// 2×2 system; the Jacobian by implicit differentiation of the same system.
    fn predict(&mut self, v: Vector2<f64>, i_norm: f64) {
        let j = Matrix2::new(0.0, -1.0, 1.0, 0.0);
        let (r, x) = (self.x[2], self.x[3]);
        let l_by_dt = x / (TAU * f64::from(ADC_LOCK_Q));
        let i = Vector2::new(self.x[0], self.x[1]);
        let system = Matrix2::identity() * (r + l_by_dt) + j * x;
        let inverse = system.try_inverse().expect("X is bounded away from 0");
        let next = inverse * (i * l_by_dt + v);
        let kappa = 1.0 / (TAU * f64::from(ADC_LOCK_Q));
        let by_r = -inverse * next;
        let by_l = match self.jacobian {
            Jacobian::Analytic => Vector2::zeros(),
            Jacobian::Exact => (i - next) * kappa,
        };
        let by_x = inverse * (by_l - j * next);
        let mut f = Matrix4::identity();
        f.fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&(inverse * l_by_dt));
        f.fixed_view_mut::<2, 1>(0, 2).copy_from(&by_r);
        f.fixed_view_mut::<2, 1>(0, 3).copy_from(&by_x);
        self.x.fixed_rows_mut::<2>(0).copy_from(&next);
        self.p = f * self.p * f.transpose();
        let growing = IMPEDANCE + IMPEDANCE_BY_CURRENT / i_norm;
        for (d, q) in [CURRENT, CURRENT, growing, growing].into_iter().enumerate() {
            self.p[(d, d)] += q;
        }
        for d in [2, 3] {
            self.p[(d, d)] = self.p[(d, d)].min(CEILING);
        }
    }
}
