//! Measurement update: I, both components at once.
//!
//! With S = P_II + r and gains K_I = P_II / S, K_Z = P_IZ* / S, the new P_II is P_II·r/S and P_IZ
//! shrinks by r/S: products, no cancellation. P_ZZ loses |P_IZ|²/S, which rounding could turn
//! negative: a floor stands there.

use super::{Ekf, VARIANCE_FLOOR, within};
use crate::fixed::{Complex, Reciprocal, narrow_fitting, narrow_within, wide};

/// Fractional bits of gains, ±128: at 1 A, where the gain is largest, a milliampere of innovation
/// moves R by 7 mohm, 54 in the units of the filter.
const GAIN_BITS: u32 = 24;

impl Ekf {
    #[inline(always)]
    pub(super) fn update(&mut self, measured: Complex) {
        let r = self.noise.measurement;
        let p = &mut self.p;
        // P and S share their format, so a gain is a plain ratio. S is the sum of these two, below 2^32: each is at most 1.
        let (of_r, of_ii) = (r as u32, p.ii as u32);
        let by_s = Reciprocal::of_short(of_r.wrapping_add(of_ii));
        let (shrink, to_i) = (by_s.share(of_r, GAIN_BITS), by_s.share(of_ii, GAIN_BITS));
        // K_Z*.
        let to_z = by_s.scale_both(p.iz, GAIN_BITS as i32);
        let shrunk = |x: i32| narrow_fitting(wide(x, shrink), GAIN_BITS);
        let lost = wide(to_z.re, p.iz.re) + wide(to_z.im, p.iz.im);
        p.zz =
            p.zz.saturating_sub(narrow_within(lost, GAIN_BITS))
                .max(VARIANCE_FLOOR);
        p.ii = shrunk(p.ii).max(1);
        p.iz = Complex {
            re: shrunk(p.iz.re),
            im: shrunk(p.iz.im),
        };
        // Within ±256 A, beyond every ADC: two products of it stay below 2^62.
        let e = Complex {
            re: within(measured.re.saturating_sub(self.i.re)),
            im: within(measured.im.saturating_sub(self.i.im)),
        };
        let moved = |x: i32, by: i64| x.saturating_add(narrow_within(by, GAIN_BITS));
        self.i = Complex {
            re: moved(self.i.re, wide(to_i, e.re)),
            im: moved(self.i.im, wide(to_i, e.im)),
        };
        self.r = moved(self.r, wide(to_z.re, e.re) + wide(to_z.im, e.im));
        self.x = moved(self.x, wide(to_z.re, e.im) - wide(to_z.im, e.re));
    }
}
