//! The arithmetic of one time step: tangent, elimination, coupling of the rings, back
//! substitution.

use pulp::{Simd, WithSimd};

use super::nodes::NodeCoefficients;
use super::state::{FluxLine, RingLoad};
use crate::spd;

/// The first half of a step, compiled for each instruction set that `pulp` detects. Only the
/// number of lanes differs, never the operations: results are the same on all of them.
pub(super) struct Predict<'a, const N: usize, C>(pub(super) &'a mut RingLoad<N, C>);

impl<const N: usize, C: NodeCoefficients<N>> WithSimd for Predict<'_, N, C> {
    type Output = FluxLine;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> FluxLine {
        self.0.linearise();
        self.0.eliminate();
        self.0.couple()
    }
}

/// The second half of a step.
pub(super) struct Commit<'a, const N: usize, C>(pub(super) &'a mut RingLoad<N, C>, pub(super) f64);

impl<const N: usize, C: NodeCoefficients<N>> WithSimd for Commit<'_, N, C> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.back_substitute(self.1);
    }
}

impl<const N: usize, C: NodeCoefficients<N>> RingLoad<N, C> {
    #[inline(always)]
    fn linearise(&mut self) {
        for n in 0..self.h.now.len() {
            let (now, before) = (self.h.now[n], self.h.before[n]);
            let mut trial = [0.0; N];
            for j in 0..N {
                trial[j] = 2.0 * now[j] - before[j];
            }
            self.tangent(n, &trial);
        }
    }

    /// Tangent of B(H) at the trial field of depth node `n`.
    #[inline(always)]
    pub(super) fn tangent(&mut self, n: usize, trial: &[f64; N]) {
        (self.slope[n], self.offset[n]) = self.nodes.tangent(n, trial);
    }

    /// From the deepest node up: each node's H as a linear function of the one above.
    #[inline(always)]
    pub(super) fn eliminate(&mut self) {
        let nodes = self.h.now.len();
        let (mut e, mut f) = ([0.0; N], [0.0; N]);
        for n in (1..nodes).rev() {
            let (up, down) = (self.nodes.conductance(n - 1), self.nodes.conductance(n));
            let store = self.nodes.storage(n);
            let (slope, offset) = (&self.slope[n], &self.offset[n]);
            let (now, before) = (&self.b.now[n], &self.b.before[n]);
            for j in 0..N {
                let diagonal = store[j] * slope[j] + up[j] + down[j] - down[j] * e[j];
                let known = store[j] * ((4.0 * now[j] - before[j]) * (1.0 / 3.0) - offset[j])
                    + down[j] * f[j];
                let inverse = 1.0 / diagonal;
                e[j] = up[j] * inverse;
                f[j] = known * inverse;
            }
            self.e[n] = e;
            self.f[n] = f;
        }
    }

    /// Rings, gap and coil: solves for A = a0 + a1 i.
    #[inline(always)]
    pub(super) fn couple(&mut self) -> FluxLine {
        let unit = self.nodes.unit();
        let cell = self.nodes.storage(0).map(|storage| storage * unit);
        let drive = self.nodes.conductance(0).map(|g| unit * g);
        let mut m = self.s;
        let mut out = self.surface;
        for j in 0..N {
            let (now, before) = (self.a_inner.now[j], self.a_inner.before[j]);
            out.inner_base[j] = (4.0 * now - before) * (1.0 / 3.0) - drive[j] * self.f[1][j];
            out.base[j] = out.inner_base[j] + cell[j] * self.offset[0][j];
            out.gain[j] = drive[j] * (1.0 - self.e[1][j]) + cell[j] * self.slope[0][j];
            let stiffness = self.w[j] / out.gain[j];
            m[j][j] += stiffness;
            out.a0[j] = stiffness * out.base[j];
            out.a1[j] = self.p[j];
        }
        spd::solve_two(&mut m, &mut out.a0, &mut out.a1);
        self.surface = out;
        let (mut lambda0, mut l) = (0.0, self.l0_h);
        for j in 0..N {
            lambda0 += self.p[j] * out.a0[j];
            l += self.p[j] * out.a1[j];
        }
        FluxLine {
            lambda0_wb: lambda0,
            l_h: l,
        }
    }

    /// From the surface down with the current known; shifts the history.
    #[inline(always)]
    fn back_substitute(&mut self, i_a: f64) {
        let unit = self.nodes.unit();
        let drive = self.nodes.conductance(0).map(|g| unit * g);
        let nodes = self.h.now.len();
        let mut h = [0.0; N];
        let mut inner = [0.0; N];
        for j in 0..N {
            let s = &self.surface;
            h[j] = (s.a0[j] + s.a1[j] * i_a - s.base[j]) / s.gain[j];
            inner[j] = s.inner_base[j] + drive[j] * (1.0 - self.e[1][j]) * h[j];
        }
        self.a_inner.before = self.a_inner.now;
        self.a_inner.now = inner;
        // The older instant's arrays take the new one.
        std::mem::swap(&mut self.h.now, &mut self.h.before);
        std::mem::swap(&mut self.b.now, &mut self.b.before);
        for n in 0..nodes {
            if n > 0 {
                let (e, f) = (&self.e[n], &self.f[n]);
                for j in 0..N {
                    h[j] = e[j] * h[j] + f[j];
                }
            }
            let (slope, offset) = (&self.slope[n], &self.offset[n]);
            let mut b = [0.0; N];
            for j in 0..N {
                b[j] = slope[j] * h[j] + offset[j];
            }
            self.h.now[n] = h;
            self.b.now[n] = b;
        }
    }
}
