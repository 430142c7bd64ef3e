//! One step of the paper's four-state filter, eq. (15)-(18), as sparse products.
//!
//! State x = (i, change of i, R, L/T_s). The transition only adds x2 to x1, the first measurement
//! depends on x1 alone, and the second (v = x1·x3 + x2·x4) has the gradient (x3, x4, x1, x2), so that no
//! 4×4 product is needed. Both measurements are linearised at the prediction and applied together. The
//! second's gain is computed from sums that depend neither on the prediction nor on the first's division.

/// State of the filter.
pub type FilterState = [f64; 4];

/// Symmetric covariance, upper triangle by rows: 11 12 13 14 22 23 24 33 34 44.
pub type Covariance = [f64; 10];

/// Noise and transition of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Factor with which x2 adds to x1 in a step: 1 with x2 a change per sample, T_s with x2 a rate.
    pub f12: f64,
    /// Process variances of one step.
    pub q: [f64; 4],
    /// Process covariance of x3 and x4.
    pub q34: f64,
    /// Measurement variances of current and voltage.
    pub r: [f64; 2],
}

/// State of the filter between two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvelopeFilter {
    /// Estimated state.
    pub x: FilterState,
    /// Covariance of the state.
    pub p: Covariance,
}

/// Values of a step that the smoother needs.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Innovation {
    /// Gradient of the voltage at the prediction.
    pub h: FilterState,
    /// Gains of current and voltage.
    pub k: [FilterState; 2],
    /// Innovations of current and voltage over their variances.
    pub weighted: [f64; 2],
    /// Reciprocal variances of the innovations of current and voltage.
    pub by_s: [f64; 2],
}

impl EnvelopeFilter {
    /// Predicts one sample ahead and applies its current and voltage.
    #[inline(always)]
    pub fn step(&mut self, model: &Model, i: f64, v: f64) -> Innovation {
        let [x1, x2, x3, x4] = self.x;
        let [p11, p12, p13, p14, p22, p23, p24, p33, p34, p44] = self.p;
        let (f, q) = (model.f12, &model.q);
        let x1 = x1 + f * x2;
        // u = P⁻h and s = hᵀP⁻h + r of the voltage, with P⁻ = F P Fᵀ + Q and g = Fᵀh: from the old P,
        // so that they do not wait for the prediction.
        let h = [x3, x4, x1, x2];
        let g = [h[0], h[1] + f * h[0], h[2], h[3]];
        let w = [
            (p11 * g[0] + p12 * g[1]) + (p13 * g[2] + p14 * g[3]),
            (p12 * g[0] + p22 * g[1]) + (p23 * g[2] + p24 * g[3]),
            (p13 * g[0] + p23 * g[1]) + (p33 * g[2] + p34 * g[3]),
            (p14 * g[0] + p24 * g[1]) + (p34 * g[2] + p44 * g[3]),
        ];
        let qh = [
            q[0] * h[0],
            q[1] * h[1],
            q[2] * h[2] + model.q34 * h[3],
            q[3] * h[3] + model.q34 * h[2],
        ];
        let noise = (qh[0] * h[0] + qh[1] * h[1]) + (qh[2] * h[2] + qh[3] * h[3]) + model.r[1];
        let s_v = (w[0] * g[0] + w[1] * g[1]) + (w[2] * g[2] + w[3] * g[3]) + noise;
        let u = [
            w[0] + (f * w[1] + qh[0]),
            w[1] + qh[1],
            w[2] + qh[2],
            w[3] + qh[3],
        ];
        // P ← P⁻.
        let p11 = p11 + f * (2.0 * p12 + f * p22) + q[0];
        let p12 = p12 + f * p22;
        let p13 = p13 + f * p23;
        let p14 = p14 + f * p24;
        let p22 = p22 + q[1];
        let p33 = p33 + q[2];
        let p34 = p34 + model.q34;
        let p44 = p44 + q[3];
        // Current first: the remaining u and s after its update, and the voltage's innovation.
        let by_s1 = 1.0 / (p11 + model.r[0]);
        let k1 = [p11 * by_s1, p12 * by_s1, p13 * by_s1, p14 * by_s1];
        let e1 = i - x1;
        let c = u[0] * by_s1;
        let by_s2 = 1.0 / (s_v - u[0] * c);
        let u = [
            u[0] - p11 * c,
            u[1] - p12 * c,
            u[2] - p13 * c,
            u[3] - p14 * c,
        ];
        let e2 = (v - (x1 * x3 + x2 * x4)) - c * e1;
        // All products before the second division is needed.
        self.x = [
            (x1 + k1[0] * e1) + (u[0] * e2) * by_s2,
            (x2 + k1[1] * e1) + (u[1] * e2) * by_s2,
            (x3 + k1[2] * e1) + (u[2] * e2) * by_s2,
            (x4 + k1[3] * e1) + (u[3] * e2) * by_s2,
        ];
        self.p = [
            (p11 - k1[0] * p11) - (u[0] * u[0]) * by_s2,
            (p12 - k1[0] * p12) - (u[0] * u[1]) * by_s2,
            (p13 - k1[0] * p13) - (u[0] * u[2]) * by_s2,
            (p14 - k1[0] * p14) - (u[0] * u[3]) * by_s2,
            (p22 - k1[1] * p12) - (u[1] * u[1]) * by_s2,
            (p23 - k1[1] * p13) - (u[1] * u[2]) * by_s2,
            (p24 - k1[1] * p14) - (u[1] * u[3]) * by_s2,
            (p33 - k1[2] * p13) - (u[2] * u[2]) * by_s2,
            (p34 - k1[2] * p14) - (u[2] * u[3]) * by_s2,
            (p44 - k1[3] * p14) - (u[3] * u[3]) * by_s2,
        ];
        let k2 = u.map(|u| u * by_s2);
        Innovation {
            h,
            k: [k1, k2],
            weighted: [e1 * by_s1, e2 * by_s2],
            by_s: [by_s1, by_s2],
        }
    }

    /// Voltage that the state implies: x1·x3 + x2·x4.
    #[inline(always)]
    pub fn v(&self) -> f64 {
        self.x[0] * self.x[2] + self.x[1] * self.x[3]
    }

    /// Returns `true` if state and covariance are finite, and the variances positive.
    pub fn is_sound(&self) -> bool {
        let diagonal = [0, 4, 7, 9].map(|k| self.p[k]);
        self.x.iter().chain(&self.p).all(|x| x.is_finite()) && diagonal.iter().all(|d| *d > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

    use super::*;

    fn dense(p: &Covariance) -> Matrix4<f64> {
        let [a, b, c, d, e, f, g, h, i, j] = *p;
        Matrix4::new(a, b, c, d, b, e, f, g, c, f, h, i, d, g, i, j)
    }

    /// Eq. (15)-(18) in matrix form, both measurements at once, Joseph's form.
    fn textbook(
        x: &FilterState,
        p: &Covariance,
        m: &Model,
        y: [f64; 2],
    ) -> (Vector4<f64>, Matrix4<f64>) {
        let mut f = Matrix4::identity();
        f[(0, 1)] = m.f12;
        let mut q = Matrix4::from_diagonal(&Vector4::from(m.q));
        q[(2, 3)] = m.q34;
        q[(3, 2)] = m.q34;
        let x = f * Vector4::from(*x);
        let p = f * dense(p) * f.transpose() + q;
        let h = Matrix2x4::new(1.0, 0.0, 0.0, 0.0, x[2], x[3], x[0], x[1]);
        let r = Matrix2::from_diagonal(&Vector2::from(m.r));
        let s = h * p * h.transpose() + r;
        let k = p * h.transpose() * s.try_inverse().unwrap();
        let predicted = Vector2::new(x[0], x[0] * x[2] + x[1] * x[3]);
        let rest = Matrix4::identity() - k * h;
        let p = rest * p * rest.transpose() + k * r * k.transpose();
        (x + k * (Vector2::from(y) - predicted), p)
    }

    #[test]
    fn a_step_is_the_textbook_filter() {
        let model = Model {
            f12: 0.7,
            q: [1e-3, 2e-3, 3e-4, 4e-2],
            q34: 1e-4,
            r: [0.02, 1.3],
        };
        let mut filter = EnvelopeFilter {
            x: [1.0, -0.3, 4.0, 20.0],
            p: [0.5, 0.02, 0.01, -0.03, 0.3, 0.02, 0.04, 0.8, 0.1, 2.0],
        };
        for n in 0..50 {
            let y = [(f64::from(n) * 0.7).sin(), 7.0 * (f64::from(n) * 0.7).cos()];
            let (x, p) = textbook(&filter.x, &filter.p, &model, y);
            filter.step(&model, y[0], y[1]);
            assert!((Vector4::from(filter.x) - x).norm() < 1e-9 * (1.0 + x.norm()));
            assert!((dense(&filter.p) - p).norm() < 1e-9 * (1.0 + p.norm()));
            assert!(filter.is_sound());
        }
    }
}
