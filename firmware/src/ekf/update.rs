//! Measurement update: the two components of I, one after the other.
//!
//! With S = P_kk + r and gains K = P_·k / S, the new variance of the measured component is
//! P_kk·r/S and its covariances shrink by r/S: products, no cancellation. The other entries lose
//! K·P_k·, which rounding can turn negative only on the diagonal, where a floor stands.

use super::{Ekf, VARIANCE_FLOOR};
use crate::fixed::{Complex, Reciprocal, narrow_fitting, narrow_within, wide};

/// Fractional bits of gains, ±128: at 1 A, where the gain is largest, a milliampere of innovation
/// moves R by 7 mohm, 54 in the units of the filter.
const GAIN_BITS: u32 = 24;

impl Ekf {
    pub(super) fn update(&mut self, measured: Complex) {
        self.update_component(0, measured.re);
        self.update_component(1, measured.im);
    }

    /// `k` = 0 measures the real part, 1 the imaginary one. Inlined, so that `k` is a constant.
    #[inline(always)]
    fn update_component(&mut self, k: usize, measured: i32) {
        let r = self.noise.measurement;
        let other = 1 - k;
        let p = &mut self.p;
        let own = p.ii[2 * k].max(0);
        let cross = p.ii[1];
        let row = p.it[k];
        let s = u64::from(own.unsigned_abs()) + u64::from(r.unsigned_abs());
        // P and S share their format, so a gain is a plain ratio. S is between 2^12 and 2^32, for
        // which the factor exists.
        let by_s = Reciprocal::of(s).factor(GAIN_BITS as i32);
        let gain = |p: i32| by_s.times(p);
        // S is the sum of these two: both ratios are at most 1.
        let shrink = by_s.times_fitting(r);
        let (to_own, to_other) = (by_s.times_fitting(own), gain(cross));
        let to_theta = [gain(row[0]), gain(row[1])];

        let shrunk = |x: i32| narrow_fitting(wide(x, shrink), GAIN_BITS);
        let lost =
            |x: i32, gain: i32, y: i32| x.saturating_sub(narrow_within(wide(gain, y), GAIN_BITS));
        p.ii[2 * k] = shrunk(own).max(1);
        p.ii[1] = shrunk(cross);
        p.ii[2 * other] = lost(p.ii[2 * other], to_other, cross).max(1);
        p.it[other] = [0, 1].map(|theta| lost(p.it[other][theta], to_other, row[theta]));
        p.it[k] = row.map(shrunk);
        p.tt[0] = lost(p.tt[0], to_theta[0], row[0]).max(VARIANCE_FLOOR);
        p.tt[1] = lost(p.tt[1], to_theta[0], row[1]);
        p.tt[2] = lost(p.tt[2], to_theta[1], row[1]).max(VARIANCE_FLOOR);

        let predicted = if k == 0 { self.i.re } else { self.i.im };
        let innovation = measured.saturating_sub(predicted);
        let moved =
            |x: i32, gain: i32| x.saturating_add(narrow_within(wide(gain, innovation), GAIN_BITS));
        let (own_new, other_old) = (moved(predicted, to_own), [self.i.im, self.i.re][k]);
        let other_new = moved(other_old, to_other);
        self.i = if k == 0 {
            Complex {
                re: own_new,
                im: other_new,
            }
        } else {
            Complex {
                re: other_new,
                im: own_new,
            }
        };
        self.r = moved(self.r, to_theta[0]);
        self.x = moved(self.x, to_theta[1]);
    }
}
