//! Time update: current by the backward difference, covariance by its derivative.

use super::{COVARIANCE_BITS, Ekf, KAPPA_Q31, VARIANCE_CEILING, within};
use crate::fixed::{Complex, Reciprocal, narrow_fitting, narrow_within, wide};
use crate::sense::demodulator::STATE_BITS;

/// Shift of a product of two state mantissas back to one.
const Q: u32 = STATE_BITS;

/// `b` is within ±2^30, or `a` is.
#[inline(always)]
fn product(a: Complex, b: Complex) -> Complex {
    Complex {
        re: narrow_within(wide(a.re, b.re) - wide(a.im, b.im), Q),
        im: narrow_within(wide(a.re, b.im) + wide(a.im, b.re), Q),
    }
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
        self.i = product(g, drive);
        // A = ∂I'/∂I = κX/D, B = ∂I'/∂Z = −I'/D.
        let a = Complex {
            re: narrow_fitting(wide(kx, g.re), Q),
            im: narrow_fitting(wide(kx, g.im), Q),
        };
        let minus_b = product(g, self.i);
        self.propagate(
            a,
            Complex {
                re: within(minus_b.re.saturating_neg()),
                im: within(minus_b.im.saturating_neg()),
            },
        );
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
        let n = [0, 1].map(|part| within(narrow_within(a_iz[part] + b_zz[part], Q)));
        let twice = [0, 1].map(|part| within(narrow_within(2 * a_iz[part] + b_zz[part], Q)));
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
        let by_norm = Reciprocal::of(i_norm).factor(2 * Q as i32);
        let growing = by_norm.times(q.impedance_by_current);
        let grown = p.zz.saturating_add(q.impedance).saturating_add(growing);
        p.zz = grown.min(VARIANCE_CEILING);
    }
}

const _: () = assert!(COVARIANCE_BITS < 31 && Q == 26);
