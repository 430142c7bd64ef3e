//! The same filter in f32, written the way the fixed-point one is, to compare what they cost. It
//! never runs on a board.

use core::f32::consts::TAU;

type Complex = [f32; 2];

/// Variances as in `ihd_firmware::ekf::Noise::TUNED`, in A² and ohm².
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
    ii: [f32; 3],
    it: [[f32; 2]; 2],
    tt: [f32; 3],
    held: bool,
}

fn product(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

fn dot4(a: [f32; 2], b: [f32; 2], c: [f32; 2], d: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + c[0] * d[0] + c[1] * d[1]
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
            ii: [MEASUREMENT, 0.0, MEASUREMENT],
            it: [[0.0; 2]; 2],
            tt: [CEILING, 0.0, CEILING],
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
            self.ii = [MEASUREMENT, 0.0, MEASUREMENT];
            self.it = [[0.0; 2]; 2];
            self.i = [i_re, i_im];
            self.held = true;
            return;
        }
        if self.held {
            self.i = [i_re, i_im];
        }
        self.held = false;
        self.predict([v_re, v_im], norm);
        self.update(0, i_re);
        self.update(1, i_im);
        self.r = self.r.clamp(0.01, 20.0);
        self.x = self.x.clamp(0.5, 60.0);
    }

    fn predict(&mut self, v: Complex, norm: f32) {
        let kx = KAPPA * self.x;
        let d = [self.r + kx, self.x];
        let inverse = 1.0 / (d[0] * d[0] + d[1] * d[1]);
        let g = [d[0] * inverse, -d[1] * inverse];
        let before = self.i;
        self.i = product(g, [kx * before[0] + v[0], kx * before[1] + v[1]]);
        let a = [kx * g[0], kx * g[1]];
        let by_r = product(g, self.i);
        let by_x = product(
            g,
            [
                KAPPA * (before[0] - self.i[0]) + self.i[1],
                KAPPA * (before[1] - self.i[1]) - self.i[0],
            ],
        );
        self.propagate(
            [[a[0], -a[1]], [a[1], a[0]]],
            [[-by_r[0], by_x[0]], [-by_r[1], by_x[1]]],
        );
        let growing = IMPEDANCE + IMPEDANCE_BY_CURRENT / norm;
        for k in [0, 2] {
            self.ii[k] += CURRENT;
            self.tt[k] = (self.tt[k] + growing).min(CEILING);
        }
        self.tt[1] = self.tt[1].clamp(-CEILING, CEILING);
    }

    fn propagate(&mut self, a: [[f32; 2]; 2], b: [[f32; 2]; 2]) {
        let tt = [[self.tt[0], self.tt[1]], [self.tt[1], self.tt[2]]];
        let ii = [[self.ii[0], self.ii[1]], [self.ii[1], self.ii[2]]];
        let it = self.it;
        let mut n = [[0.0; 2]; 2];
        let mut w = [[0.0; 2]; 2];
        for row in 0..2 {
            for col in 0..2 {
                n[row][col] = dot4(a[row], [it[0][col], it[1][col]], b[row], tt[col]);
                w[row][col] = dot4(a[row], ii[col], b[row], it[col]);
            }
        }
        self.ii = [
            dot4(w[0], a[0], n[0], b[0]),
            dot4(w[0], a[1], n[0], b[1]),
            dot4(w[1], a[1], n[1], b[1]),
        ];
        self.it = n;
    }

    fn update(&mut self, k: usize, measured: f32) {
        let (other, own, cross, row) = (1 - k, self.ii[2 * k], self.ii[1], self.it[k]);
        let inverse = 1.0 / (own + MEASUREMENT);
        let shrink = MEASUREMENT * inverse;
        let (to_own, to_other) = (own * inverse, cross * inverse);
        let to_theta = [row[0] * inverse, row[1] * inverse];
        self.ii[2 * k] = own * shrink;
        self.ii[1] = cross * shrink;
        self.ii[2 * other] -= to_other * cross;
        for (theta, from) in row.into_iter().enumerate() {
            self.it[other][theta] -= to_other * from;
            self.it[k][theta] = from * shrink;
        }
        self.tt[0] = (self.tt[0] - to_theta[0] * row[0]).max(FLOOR);
        self.tt[1] -= to_theta[0] * row[1];
        self.tt[2] = (self.tt[2] - to_theta[1] * row[1]).max(FLOOR);
        let innovation = measured - self.i[k];
        self.i[k] += to_own * innovation;
        self.i[other] += to_other * innovation;
        self.r += to_theta[0] * innovation;
        self.x += to_theta[1] * innovation;
    }
}
