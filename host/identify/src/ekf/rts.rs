//! Forward-backward smoother of Rauch, Tung and Striebel, in the form of Bryson and Frazier: the
//! same estimates, without inverting a covariance at every sample.
//!
//! Backwards through a measurement with gradient h, gain k and innovation e of variance s:
//! λ ← λ − h·(e/s + kᵀλ), Λ ← Λ − h(Λk)ᵀ − (Λk)hᵀ + h hᵀ(1/s + kᵀΛk); through the transition:
//! λ ← Fᵀλ, Λ ← FᵀΛF. The smoothed state is x − Pλ, its covariance P − PΛP.
//!
//! Only every [`CHUNK`]th state of the forward pass is kept; the others are computed again.

use super::step::{Covariance, EnvelopeFilter, FilterState, Innovation, Model};

/// Samples between two kept states: 1 MB of innovations, which stay in the cache.
pub const CHUNK: usize = 4096;

/// Runs forward and backward. `visit` receives, from the last sample to the first, its index, the smoothed state and the
/// smoothed variances of R and x4.
pub fn smooth(
    model: &Model,
    start: EnvelopeFilter,
    i: &[f64],
    v: &[f64],
    mut visit: impl FnMut(usize, &FilterState, [f64; 2]),
) {
    let mut filter = start;
    let mut states = Vec::with_capacity(i.len() / CHUNK + 1);
    for (i, v) in i.chunks(CHUNK).zip(v.chunks(CHUNK)) {
        states.push(filter);
        for (i, v) in i.iter().zip(v) {
            filter.step(model, *i, *v);
        }
    }
    let mut backward = Backward::default();
    let mut steps: Vec<(EnvelopeFilter, Innovation)> = Vec::with_capacity(CHUNK);
    for (chunk, start) in states.iter().enumerate().rev() {
        let from = chunk * CHUNK;
        let to = (from + CHUNK).min(i.len());
        let mut filter = *start;
        steps.clear();
        steps.extend(i[from..to].iter().zip(&v[from..to]).map(|(i, v)| {
            let innovation = filter.step(model, *i, *v);
            (filter, innovation)
        }));
        for (k, (after, innovation)) in steps.iter().enumerate().rev() {
            let (x, variance) = backward.smoothed(after);
            visit(from + k, &x, variance);
            backward.pass(innovation, model.f12);
        }
    }
}

/// λ and Λ of the backward pass.
#[derive(Clone, Copy, Debug, Default)]
struct Backward {
    l: FilterState,
    m: Covariance,
}

/// Symmetric matrix times vector.
#[inline(always)]
fn times(m: &Covariance, k: &FilterState) -> FilterState {
    let [a, b, c, d, e, f, g, h, i, j] = *m;
    [
        (a * k[0] + b * k[1]) + (c * k[2] + d * k[3]),
        (b * k[0] + e * k[1]) + (f * k[2] + g * k[3]),
        (c * k[0] + f * k[1]) + (h * k[2] + i * k[3]),
        (d * k[0] + g * k[1]) + (i * k[2] + j * k[3]),
    ]
}

#[inline(always)]
fn dot(a: &FilterState, b: &FilterState) -> f64 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

impl Backward {
    /// Smoothed state, and smoothed variances of x3 and x4.
    #[inline(always)]
    fn smoothed(&self, after: &EnvelopeFilter) -> (FilterState, [f64; 2]) {
        let correction = times(&after.p, &self.l);
        let x = std::array::from_fn(|k| after.x[k] - correction[k]);
        let p = &after.p;
        let (row3, row4) = ([p[2], p[5], p[7], p[8]], [p[3], p[6], p[8], p[9]]);
        let left = |row: &FilterState, own: f64| own - dot(row, &times(&self.m, row));
        (x, [left(&row3, p[7]), left(&row4, p[9])])
    }

    /// Passes both measurements of a sample, the voltage first, and the transition before it.
    #[inline(always)]
    fn pass(&mut self, n: &Innovation, f12: f64) {
        self.voltage(&n.h, &n.k[1], n.weighted[1], n.by_s[1]);
        self.current(&n.k[0], n.weighted[0], n.by_s[0]);
        // Fᵀ adds f12 times the first row and column to the second.
        let m = &mut self.m;
        self.l[1] += f12 * self.l[0];
        m[4] += f12 * (2.0 * m[1] + f12 * m[0]);
        m[1] += f12 * m[0];
        m[5] += f12 * m[2];
        m[6] += f12 * m[3];
    }

    #[inline(always)]
    fn voltage(&mut self, h: &FilterState, k: &FilterState, weighted: f64, by_s: f64) {
        let mk = times(&self.m, k);
        let gain = by_s + dot(k, &mk);
        let pull = weighted + dot(k, &self.l);
        for (l, h) in self.l.iter_mut().zip(h) {
            *l -= h * pull;
        }
        let mut at = 0;
        for row in 0..4 {
            for column in row..4 {
                self.m[at] += h[row] * h[column] * gain - h[row] * mk[column] - mk[row] * h[column];
                at += 1;
            }
        }
    }

    /// Passes the measurement of the current, whose gradient is (1, 0, 0, 0).
    #[inline(always)]
    fn current(&mut self, k: &FilterState, weighted: f64, by_s: f64) {
        let mk = times(&self.m, k);
        let gain = by_s + dot(k, &mk);
        self.l[0] -= weighted + dot(k, &self.l);
        self.m[0] += gain - 2.0 * mk[0];
        self.m[1] -= mk[1];
        self.m[2] -= mk[2];
        self.m[3] -= mk[3];
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, Vector4};

    use super::*;

    fn dense(p: &Covariance) -> Matrix4<f64> {
        let [a, b, c, d, e, f, g, h, i, j] = *p;
        Matrix4::new(a, b, c, d, b, e, f, g, c, f, h, i, d, g, i, j)
    }

    /// Comparison with the textbook recursion x_s = x + P Fᵀ P⁻¹_pred (x_s' − F x), over more than one chunk.
    #[test]
    fn it_is_the_recursion_of_rauch_tung_and_striebel() {
        let model = Model {
            f12: 1.0,
            q: [1e-4, 1e-3, 1e-4, 1e-2],
            q34: 0.0,
            r: [0.01, 1.0],
        };
        let start = EnvelopeFilter {
            x: [0.0, 0.0, 3.0, 18.0],
            p: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 4.0],
        };
        let n = CHUNK + 200;
        let i: Vec<f64> = (0..n).map(|k| 5.0 * (k as f64 * 0.1).sin()).collect();
        let v: Vec<f64> = (0..n)
            .map(|k| 4.0 * 5.0 * (k as f64 * 0.1).sin() + 20.0 * 0.5 * (k as f64 * 0.1).cos())
            .collect();
        let mut got = vec![([0.0; 4], [0.0; 2]); n];
        smooth(&model, start, &i, &v, |k, x, p| got[k] = (*x, p));

        let mut filter = start;
        let forward: Vec<EnvelopeFilter> = i
            .iter()
            .zip(&v)
            .map(|(i, v)| {
                filter.step(&model, *i, *v);
                filter
            })
            .collect();
        let mut f = Matrix4::identity();
        f[(0, 1)] = model.f12;
        let q = Matrix4::from_diagonal(&Vector4::from(model.q));
        let last = forward[n - 1];
        let (mut x, mut p) = (Vector4::from(last.x), dense(&last.p));
        for k in (0..n - 1).rev() {
            let own = dense(&forward[k].p);
            let predicted = f * own * f.transpose() + q;
            let gain = own * f.transpose() * predicted.try_inverse().unwrap();
            x = Vector4::from(forward[k].x) + gain * (x - f * Vector4::from(forward[k].x));
            p = own + gain * (p - predicted) * gain.transpose();
            let wanted = Vector4::from(got[k].0);
            assert!((wanted - x).norm() < 1e-6 * x.norm(), "{k}: {wanted} {x}");
            for (state, variance) in [(2, got[k].1[0]), (3, got[k].1[1])] {
                let right = p[(state, state)];
                assert!(
                    (variance / right - 1.0).abs() < 1e-4,
                    "{k}: {variance} {right}"
                );
            }
        }
    }
}
