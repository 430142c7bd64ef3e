//! The same filter in f32, written the way the fixed-point one is, to compare what they cost. It
//! never runs on a board.

use core::f32::consts::TAU;

type Complex = [f32; 2];

/// Variances as in `ihd_firmware::estimate::ekf::Noise::TUNED`, in A² and ohm².
const MEASUREMENT: f32 = 0.05 * 0.05;
const CURRENT: f32 = 0.02 * 0.02;
const IMPEDANCE: f32 = 0.01 * 0.01;
const IMPEDANCE_BY_CURRENT: f32 = 0.6 * 0.6;
const CEILING: f32 = 1.0;
const FLOOR: f32 = 1e-5;
/// 1/(2πq).
const KAPPA: f32 = 1.0 / (TAU * 3.0);

/// Extended Kalman filter in volt, ampere and ohm.
pub struct FloatEkf {
    i: Complex,
    r: f32,
    x: f32,
    omega: f32,
    ii: f32,
    iz: Complex,
    zz: f32,
    held: bool,
}

fn product(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

impl FloatEkf {
    /// Volt per mantissa of the fixed-point phasors.
    pub const VOLT: f32 = 32.0 / (1u32 << 26) as f32;
    /// Ampere per mantissa.
    pub const AMPERE: f32 = 16.0 / (1u32 << 26) as f32;

    pub fn new(f_sw_hz: f32, r_ohm: f32, l_h: f32) -> Self {
        let omega = TAU * f_sw_hz;
        Self {
            i: [0.0; 2],
            r: r_ohm,
            x: omega * l_h,
            omega,
            ii: MEASUREMENT,
            iz: [0.0; 2],
            zz: CEILING,
            held: true,
        }
    }

    pub fn r_ohm(&self) -> f32 {
        self.r
    }

    pub fn l_h(&self) -> f32 {
        self.x / self.omega
    }

    /// `z` is V and I, real and imaginary part each.
    pub fn step(&mut self, z: [f32; 4]) {
        let [v_re, v_im, i_re, i_im] = z;
        let norm = i_re * i_re + i_im * i_im;
        if norm < 1.0 {
            self.ii = MEASUREMENT;
            self.iz = [0.0; 2];
            self.i = [i_re, i_im];
            self.held = true;
            return;
        }
        if self.held {
            self.i = [i_re, i_im];
        }
        self.held = false;
        self.predict([v_re, v_im], norm);
        self.update([i_re, i_im]);
        self.r = self.r.clamp(0.01, 20.0);
        self.x = self.x.clamp(0.5, 60.0);
    }

    fn predict(&mut self, v: Complex, norm: f32) {
        let kx = KAPPA * self.x;
        let d = [self.r + kx, self.x];
        let inverse = 1.0 / (d[0] * d[0] + d[1] * d[1]);
        let g = [d[0] * inverse, -d[1] * inverse];
        self.i = product(g, [kx * self.i[0] + v[0], kx * self.i[1] + v[1]]);
        let a = [kx * g[0], kx * g[1]];
        let b = product(g, self.i).map(|x| -x);
        let a_iz = product(a, self.iz);
        let b_zz = b.map(|x| x * self.zz);
        self.iz = [a_iz[0] + b_zz[0], a_iz[1] + b_zz[1]];
        self.ii = (a[0] * a[0] + a[1] * a[1]) * self.ii
            + (a_iz[0] + self.iz[0]) * b[0]
            + (a_iz[1] + self.iz[1]) * b[1]
            + CURRENT;
        self.zz = (self.zz + IMPEDANCE + IMPEDANCE_BY_CURRENT / norm).min(CEILING);
    }

    fn update(&mut self, measured: Complex) {
        let inverse = 1.0 / (self.ii + MEASUREMENT);
        let (shrink, to_i) = (MEASUREMENT * inverse, self.ii * inverse);
        let to_z = [self.iz[0] * inverse, -self.iz[1] * inverse];
        let lost = to_z[0] * self.iz[0] - to_z[1] * self.iz[1];
        self.zz = (self.zz - lost).max(FLOOR);
        self.ii *= shrink;
        self.iz = self.iz.map(|x| x * shrink);
        let e = [measured[0] - self.i[0], measured[1] - self.i[1]];
        self.i = [self.i[0] + to_i * e[0], self.i[1] + to_i * e[1]];
        let moved = product(to_z, e);
        self.r += moved[0];
        self.x += moved[1];
    }
}
