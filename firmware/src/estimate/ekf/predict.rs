//! Time update: current by the backward difference, covariance by its derivative.

use super::{COVARIANCE_BITS, Ekf, KAPPA_Q31, Noise, VARIANCE_CEILING, WITHIN_BITS};
use crate::fixed::{Complex, Reciprocal, narrow_fitting, narrow_to, narrow_within, wide};
use crate::sense::demodulator::STATE_BITS;

/// Shift of a product of two state mantissas back to one.
const Q: u32 = STATE_BITS;

/// Bound of [`super::Noise::impedance_by_current`], ten bits below the largest number: (2 V)².
const IMPEDANCE_BY_CURRENT_BOUND: i32 = 1 << 21;

/// 2κ, for which the shift is 32.
const TWICE_KAPPA: i32 = 2 * KAPPA_Q31;

impl Ekf {
    /// `i_norm` is |I|² of the measurement, twice the state's fractional bits.
    pub(super) fn predict(&mut self, v: Complex, i_norm: u64) {
        // Within 2^27, as X is within 2^31.
        let kx = narrow_fitting(wide(self.x, TWICE_KAPPA), 32);
        let d = Complex {
            re: self.r.saturating_add(kx),
            im: self.x,
        };
        // G* = 1/D* = D/|D|², both parts positive; the norm carries 2·26 fractional bits, D and the result 26. X ≥ 2^24
        // keeps the norm above 2^48 and G within 2^28; with z zeros in the norm D has z/2 bits to spare.
        let by_norm = Reciprocal::of_long(d.norm_squared());
        let spare = by_norm.zeros() >> 1;
        let part = |x: i32| by_norm.scale_positive(x as u32, 2 * Q as i32, spare);
        let g = [part(d.re), part(d.im)];
        // κX·I + V: V has no fraction to round.
        let drive = |i: i32, v: i32| narrow_within(wide(kx, i), Q).saturating_add(v);
        let drive = [drive(self.i.re, v.re), drive(self.i.im, v.im)];
        self.i = Complex {
            re: narrow_within(wide(g[0], drive[0]) + wide(g[1], drive[1]), Q),
            im: narrow_within(wide(g[0], drive[1]) - wide(g[1], drive[0]), Q),
        };
        // A = ∂I'/∂I = κX/D, B = ∂I'/∂Z = −I'/D.
        // Both factors have the bits to spare that make the shift 32.
        let a = g.map(|g| narrow_fitting(wide(kx << 4, g << 2), Q + 6));
        let b = Complex {
            re: narrow_to(
                -wide(g[0], self.i.re) - wide(g[1], self.i.im),
                Q,
                WITHIN_BITS,
            ),
            im: narrow_to(
                wide(g[1], self.i.re) - wide(g[0], self.i.im),
                Q,
                WITHIN_BITS,
            ),
        };
        let a = Complex {
            re: a[0],
            im: -a[1],
        };
        self.propagate(a, b);
        self.add_process_noise(i_norm);
    }

    /// P ← F P Fᴴ with F = (A B; 0 1): P_IZ ← N = A P_IZ + B P_ZZ and
    /// P_II ← |A|² P_II + Re((A P_IZ + N) B*).
    ///
    /// |A| < 1, P_ZZ ≤ (1 ohm)², B, P_IZ and A P_IZ + N within ±2^30: no sum overflows.
    #[inline(always)]
    fn propagate(&mut self, a: Complex, b: Complex) {
        let p = &mut self.p;
        let a_iz = [
            wide(a.re, p.iz.re) - wide(a.im, p.iz.im),
            wide(a.re, p.iz.im) + wide(a.im, p.iz.re),
        ];
        let b_zz = [wide(b.re, p.zz), wide(b.im, p.zz)];
        let n = [0, 1].map(|part| narrow_to(a_iz[part] + b_zz[part], Q, WITHIN_BITS));
        let twice = [0, 1].map(|part| narrow_to(2 * a_iz[part] + b_zz[part], Q, WITHIN_BITS));
        let a_norm = narrow_fitting(wide(a.re, a.re) + wide(a.im, a.im), Q);
        let ii = wide(a_norm, p.ii) + wide(twice[0], b.re) + wide(twice[1], b.im);
        p.ii = narrow_within(ii, Q).max(0);
        p.iz = Complex { re: n[0], im: n[1] };
    }

    #[inline(always)]
    fn add_process_noise(&mut self, i_norm: u64) {
        let (p, q) = (&mut self.p, self.noise);
        p.ii = p.ii.saturating_add(q.current);
        // (0.6 V)²/|I|²: the norm carries twice the state's bits, the noise the covariance's.
        // It is above 2^44, or the step would have been held.
        let by_norm = Reciprocal::of_long(i_norm);
        let bound = IMPEDANCE_BY_CURRENT_BOUND - 1;
        let by_current = q.impedance_by_current.clamp(0, bound) as u32;
        let growing = by_norm.scale_positive(by_current, 2 * Q as i32, 10);
        let grown = p.zz.saturating_add(q.impedance).saturating_add(growing);
        p.zz = grown.min(VARIANCE_CEILING);
    }
}

const _: () = assert!(COVARIANCE_BITS < 31 && Q == 26);
const _: () = assert!(Noise::TUNED.impedance_by_current < IMPEDANCE_BY_CURRENT_BOUND);
