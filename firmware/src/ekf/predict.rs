//! Time update: current by the backward difference, covariance by its Jacobian.

use super::{COVARIANCE_BITS, Ekf, KAPPA_Q31, VARIANCE_CEILING};
use crate::demod::STATE_BITS;
use crate::fixed::{Complex, Reciprocal, narrow_fitting, narrow_within, wide};

/// Shift of a product of two state mantissas back to one.
const Q: u32 = STATE_BITS;

/// Bound of what multiplies a saturated covariance: with 2^30 on either side, a sum of four
/// products stays below 2^62. It is 128 A/ohm for a sensitivity, far beyond any load.
const WITHIN: i32 = (1 << 30) - 1;

/// `b` is within ±2^30, or `a` is.
#[inline(always)]
fn product(a: Complex, b: Complex) -> Complex {
    Complex {
        re: narrow_within(wide(a.re, b.re) - wide(a.im, b.im), Q),
        im: narrow_within(wide(a.re, b.im) + wide(a.im, b.re), Q),
    }
}

#[inline(always)]
fn within(x: i32) -> i32 {
    x.clamp(-WITHIN - 1, WITHIN)
}

/// Σ of four products, each below 2^60 or two below 2^61.
#[inline(always)]
fn dot4(a: [i32; 2], b: [i32; 2], c: [i32; 2], d: [i32; 2]) -> i32 {
    let sum = wide(a[0], b[0]) + wide(a[1], b[1]) + wide(c[0], d[0]) + wide(c[1], d[1]);
    narrow_within(sum, Q)
}

impl Ekf {
    /// `i_norm` is |I|² of the measurement, twice the state's fractional bits.
    pub(super) fn predict(&mut self, v: Complex, i_norm: u64) {
        let kx = narrow_fitting(wide(self.x, KAPPA_Q31), 31);
        let d = Complex {
            re: self.r.saturating_add(kx),
            im: self.x,
        };
        // 1/D = conj(D)/|D|²; the norm carries 2·26 fractional bits, D and the result 26. X ≥ 2^24
        // keeps the norm above 2^48, so the factor exists and G is within ±2^28.
        let by_norm = Reciprocal::of(d.norm_squared()).factor(2 * Q as i32);
        let g = Complex {
            re: by_norm.times_fitting(d.re),
            im: by_norm.times_fitting(-d.im),
        };
        let drive = Complex {
            re: narrow_within(wide(kx, self.i.re) + (i64::from(v.re) << Q), Q),
            im: narrow_within(wide(kx, self.i.im) + (i64::from(v.im) << Q), Q),
        };
        let before = self.i;
        self.i = product(g, drive);
        // ∂I'/∂I = κX/D, ∂I'/∂R = −I'/D, ∂I'/∂X = (κ(I − I') − j I')/D.
        let a = Complex {
            re: narrow_fitting(wide(kx, g.re), Q),
            im: narrow_fitting(wide(kx, g.im), Q),
        };
        let by_r = product(g, self.i);
        let change = |i: i32, new: i32| narrow_fitting(wide(i.saturating_sub(new), KAPPA_Q31), 31);
        let by_x = product(
            g,
            Complex {
                re: change(before.re, self.i.re).saturating_add(self.i.im),
                im: change(before.im, self.i.im).saturating_sub(self.i.re),
            },
        );
        self.propagate(
            [[a.re, a.im.saturating_neg()], [a.im, a.re]],
            [
                [within(by_r.re.saturating_neg()), within(by_x.re)],
                [within(by_r.im.saturating_neg()), within(by_x.im)],
            ],
        );
        self.add_process_noise(i_norm);
    }

    /// P ← F P Fᵀ with F = (A B; 0 1), in blocks: N = A P_It + B P_tt, W = A P_II + B P_tI,
    /// P_II ← W Aᵀ + N Bᵀ, P_It ← N.
    ///
    /// Not inlined: with what surrounds it, it needs more registers than there are, and a tenth of the
    /// step would be spent on the stack.
    ///
    /// |A| < 1 and P_tt ≤ (1 ohm)² by their bounds, B and P_It by [`WITHIN`]: no sum overflows.
    #[inline(never)]
    fn propagate(&mut self, a: [[i32; 2]; 2], b: [[i32; 2]; 2]) {
        let p = &self.p;
        let r_x = within(p.tt[1]);
        let tt = [[p.tt[0], r_x], [r_x, p.tt[2]]];
        let ii = [[p.ii[0], p.ii[1]], [p.ii[1], p.ii[2]]];
        let it = p.it.map(|row| row.map(within));
        let mut n = [[0; 2]; 2];
        let mut w = [[0; 2]; 2];
        for row in 0..2 {
            for col in 0..2 {
                n[row][col] = within(dot4(a[row], [it[0][col], it[1][col]], b[row], tt[col]));
                w[row][col] = dot4(a[row], ii[col], b[row], it[col]);
            }
        }
        let re_re = dot4(w[0], a[0], n[0], b[0]);
        let re_im = dot4(w[0], a[1], n[0], b[1]);
        let im_im = dot4(w[1], a[1], n[1], b[1]);
        self.p.ii = [re_re, re_im, im_im];
        self.p.it = n;
    }

    fn add_process_noise(&mut self, i_norm: u64) {
        let q = self.noise;
        for k in [0, 2] {
            self.p.ii[k] = self.p.ii[k].saturating_add(q.current);
        }
        // (0.6 V)²/|I|²: the norm carries twice the state's bits, the noise the covariance's.
        // It is above 2^44, or the step would have been held.
        let by_norm = Reciprocal::of(i_norm).factor(2 * Q as i32);
        let growing = by_norm.times(q.impedance_by_current);
        for k in [0, 2] {
            let grown = self.p.tt[k]
                .saturating_add(q.impedance)
                .saturating_add(growing);
            self.p.tt[k] = grown.min(VARIANCE_CEILING);
        }
        // A capped variance must still cover its covariance: |P_RX| ≤ ceiling.
        self.p.tt[1] = self.p.tt[1].clamp(-VARIANCE_CEILING, VARIANCE_CEILING);
    }
}

const _: () = assert!(COVARIANCE_BITS < 31 && Q == 26);
