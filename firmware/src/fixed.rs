//! Fixed-point arithmetic of the estimator: i32 mantissas, i64 products, one rounding per sum of
//! products, a normalised reciprocal instead of a division.

/// A complex number whose parts share the fixed-point format of their context.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Complex {
    /// Real part.
    pub re: i32,
    /// Imaginary part.
    pub im: i32,
}

impl Complex {
    /// Squared magnitude, in twice the fractional bits. Never overflows: at most 2^63.
    pub fn norm_squared(self) -> u64 {
        (i64::from(self.re) * i64::from(self.re)) as u64
            + (i64::from(self.im) * i64::from(self.im)) as u64
    }
}

/// The exact 64-bit product of two mantissas.
#[inline(always)]
pub fn wide(a: i32, b: i32) -> i64 {
    i64::from(a) * i64::from(b)
}

/// `x / 2^shift`, rounded to nearest (ties up) and saturated. `shift` from 1 to 62.
#[inline(always)]
pub fn narrow(x: i64, shift: u32) -> i32 {
    saturate((x >> (shift - 1)).saturating_add(1) >> 1)
}

/// Same as [`narrow`], for `x` below 2^62 in magnitude; what does not fit ends within 2^(32 − shift) of the bound.
#[inline(always)]
pub fn narrow_within(x: i64, shift: u32) -> i32 {
    narrow_to(x, shift, 32)
}

/// Same as [`narrow_within`], to so many bits, where `shift + bits` is above 32.
#[inline(always)]
pub fn narrow_to(x: i64, shift: u32, bits: u32) -> i32 {
    debug_assert!(x.unsigned_abs() <= 1 << 62 && (1..=62).contains(&shift));
    debug_assert!(bits <= 32 && shift + bits > 32);
    let x = x.wrapping_add(1 << (shift - 1));
    if shift > 31 {
        let bound = 1_i64 << (bits - 1);
        return (x >> shift).clamp(-bound, bound - 1) as i32;
    }
    // By halves: what does not fit shows in the upper one before it is shifted, where one instruction bounds it.
    let bound = 1 << (shift + bits - 33);
    let upper = ((x >> 32) as i32).clamp(-bound, bound - 1);
    upper << (32 - shift) | (x as u32 >> shift) as i32
}

/// Same as [`narrow_within`], where the result is known to fit.
#[inline(always)]
pub fn narrow_fitting(x: i64, shift: u32) -> i32 {
    let x = x.wrapping_add(1 << (shift - 1)) >> shift;
    debug_assert!(i32::try_from(x).is_ok());
    x as i32
}

/// Saturates to 32 bit.
#[inline(always)]
pub fn saturate(x: i64) -> i32 {
    let low = x as i32;
    if i64::from(low) == x {
        low
    } else {
        // All ones above the sign gives the bound of that sign.
        (x >> 63) as i32 ^ i32::MAX
    }
}

/// `n / d`, truncated, for `n` below 2^46 and `d` from 1 to 2^17: two divisions in hardware, where one of 64 bit is
/// a library call of some 300 cycles. A larger `d` counts as 2^17, 0 as 1.
pub fn short_quotient(n: u64, d: u32) -> u64 {
    debug_assert!(n < 1 << 46 && (1..=1 << 17).contains(&d));
    const DIGIT: u32 = 15;
    let d = d.clamp(1, 1 << 17);
    let upper = (n >> DIGIT) as u32;
    // The remainder is below 2^17, so that with another digit it fits.
    let rest = (upper % d) << DIGIT | n as u32 & ((1 << DIGIT) - 1);
    (u64::from(upper / d) << DIGIT) + u64::from(rest / d)
}

/// 1/n as `mantissa · 2^-exponent`, mantissa in (2^30, 2^31).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reciprocal {
    mantissa: i32,
    exponent: i32,
}

impl Reciprocal {
    /// The reciprocal of a positive integer to within 2^-29 of its value; of 0, that of 1.
    pub fn new(n: u64) -> Self {
        let n = n.max(1);
        let zeros = n.leading_zeros();
        Self::of_normalised(((n << zeros) >> 32) as u32, zeros)
    }

    /// Same as [`Reciprocal::new`], for a positive `n` of 32 bits.
    #[inline(always)]
    pub fn of_short(n: u32) -> Self {
        debug_assert!(n > 0);
        let zeros = (n | 1).leading_zeros();
        Self::of_normalised(n << zeros, 32 + zeros)
    }

    /// Same as [`Reciprocal::new`], for `n` from 2^32 on.
    #[inline(always)]
    pub fn of_long(n: u64) -> Self {
        debug_assert!(n >> 32 > 0);
        let (upper, lower) = ((n >> 32) as u32, n as u32);
        let zeros = (upper | 1).leading_zeros();
        let m = upper << zeros | lower >> 1 >> (31 - zeros);
        Self::of_normalised(m, zeros)
    }

    /// The reciprocal of n, with m ≤ n·2^(zeros − 32) < m + 1 and 2^31 ≤ m < 2^32.
    ///
    /// One 32-bit hardware division gives 15 bits, one Newton step doubles them. A 64-bit
    /// division would be a library call of variable time on a Cortex-M4.
    #[inline(always)]
    fn of_normalised(m: u32, zeros: u32) -> Self {
        let upper_half = |a: u32, b: u32| ((u64::from(a) * u64::from(b)) >> 32) as u32;
        // The bit is set already; naming it shows the compiler that nothing is divided by zero.
        let seed = (u32::MAX / (m >> 16 | 1 << 15)) << 15; // ≈ 2^63 / m, 16 to 17 bits
        let product = upper_half(m, seed); // ≈ 2^31
        let mantissa = upper_half(seed, product.wrapping_neg()); // ≈ 2^62 / m
        // Below 2^31, for a power of two as well: a Newton step ends below its goal.
        debug_assert!(mantissa >> 31 == 0);
        Self {
            mantissa: mantissa as i32,
            exponent: 94 - zeros as i32,
        }
    }

    /// Leading zeros of n, of 64 bits.
    #[inline(always)]
    pub fn zeros(self) -> u32 {
        (94 - self.exponent) as u32
    }

    /// Same as [`Reciprocal::scale`], where the result is known to fit 31 bits, `x · 2^spare` to fit 32, and `exponent − q +
    /// spare` to be from 33 to 62: the product's upper half is enough.
    #[inline(always)]
    pub fn scale_positive(self, x: u32, q: i32, spare: u32) -> i32 {
        let shift = self.exponent - q + spare as i32;
        debug_assert!((33..=62).contains(&shift) && x << spare >> spare == x);
        let product = u64::from(x << spare) * u64::from(self.mantissa as u32);
        ((product >> 32) as i32 + (1 << (shift - 33))) >> (shift - 32)
    }

    /// Same as [`Reciprocal::scale`], for `x` up to n, n of 32 bits and q up to 28.
    #[inline(always)]
    pub fn share(self, x: u32, q: u32) -> i32 {
        // As many bits as n has to spare make the shift 62 − q.
        let spare = self.zeros() - 32;
        debug_assert!(q <= 28 && x << spare >> spare == x);
        let product = u64::from(x << spare) * u64::from(self.mantissa as u32);
        ((product >> 32) as i32 + (1 << (29 - q))) >> (30 - q)
    }

    /// Same as [`Reciprocal::scale`] for both parts, where `exponent − q` is from 1 to 62.
    #[inline(always)]
    pub fn scale_both(self, x: Complex, q: i32) -> Complex {
        let shift = (self.exponent - q) as u32;
        debug_assert!((1..=62).contains(&shift));
        let [re, im] = [x.re, x.im].map(|part| wide(part, self.mantissa));
        if shift > 31 {
            let [re, im] = [re, im].map(|x| saturate((x + (1 << (shift - 1))) >> shift));
            return Complex { re, im };
        }
        let half = i64::from(1_u32 << (shift - 1));
        let [re, im] = [re, im].map(|x| {
            let x = x + half;
            let upper = (x >> 32) as i32;
            if upper >> (shift - 1) == upper >> 31 {
                upper << (32 - shift) | (x as u32 >> shift) as i32
            } else {
                upper >> 31 ^ i32::MAX
            }
        });
        Complex { re, im }
    }

    /// `x · 2^q / n`, rounded and saturated.
    #[inline(always)]
    pub fn scale(self, x: i32, q: i32) -> i32 {
        let product = i64::from(x) * i64::from(self.mantissa);
        match self.exponent - q {
            shift @ 1..=62 => narrow(product, shift as u32),
            shift if shift > 62 => 0,
            _ if x == 0 => 0,
            shift @ -31..=0 => saturate(product.saturating_mul(1i64 << -shift)),
            _ if x < 0 => i32::MIN,
            _ => i32::MAX,
        }
    }
}

/// `n / d`, truncated, where that is below 2^31 and `n` below 2^63: by a reciprocal, put right by the remainder, as a division
/// of 64 bit is a library call of some 300 cycles. A quotient from 2^31 on is some number from there on, by 0 that by 1.
pub fn quotient(n: u64, d: u64) -> i64 {
    let n = n.min(i64::MAX as u64);
    let d = d.clamp(1, i64::MAX as u64);
    let shift = 33u32.saturating_sub(n.leading_zeros());
    let mut quotient = i64::from(Reciprocal::new(d).scale((n >> shift) as i32, shift as i32));
    // Good to 4e-9, so a few units off; each is found by the remainder, which a wrapping product shows.
    let mut rest = (n as i64).wrapping_sub(quotient.wrapping_mul(d as i64));
    for _ in 0..16 {
        if rest < 0 {
            (quotient, rest) = (quotient - 1, rest.wrapping_add(d as i64));
        } else if rest >= d as i64 {
            (quotient, rest) = (quotient + 1, rest.wrapping_sub(d as i64));
        } else {
            break;
        }
    }
    quotient
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn narrow_rounds_to_nearest_and_saturates() {
        assert_eq!(narrow(5, 1), 3);
        assert_eq!(narrow(-5, 1), -2);
        assert_eq!(narrow(6, 2), 2);
        assert_eq!(narrow(i64::MAX, 1), i32::MAX);
        assert_eq!(narrow(i64::MIN, 1), i32::MIN);
    }

    #[test]
    fn the_reciprocal_of_a_power_of_two_and_of_what_is_next_to_it_fits() {
        for n in (1 << 31)..(1 << 31) + (1 << 17) {
            let value = f64::from(Reciprocal::of_short(n).mantissa) * 2f64.powi(-62);
            assert!((value * f64::from(n) - 1.0).abs() < 2e-9, "1/{n} = {value}");
        }
    }

    proptest! {
        #[test]
        fn the_short_forms_equal_the_general_ones(
            x in -(1i64 << 62)..=1 << 62,
            shift in 1u32..=62,
            y in any::<i32>(),
            bits in 0u32..64,
            q in -40i32..60,
        ) {
            let (within, general) = (narrow_within(x, shift), narrow(x, shift));
            let is_bound = general == i32::MAX || general == i32::MIN;
            let off = (i64::from(within) - i64::from(general)).abs();
            let may_be_off = if is_bound { 1 << (32 - shift.min(32)) } else { 1 };
            prop_assert!(off < may_be_off, "{} for {}", within, general);
            let inverse = Reciprocal::new(1 << bits | 12_345);
            let shift = inverse.exponent - q;
            if (1..=62).contains(&shift) {
                let both = inverse.scale_both(Complex { re: y, im: !y }, q);
                prop_assert_eq!([both.re, both.im], [y, !y].map(|y| inverse.scale(y, q)));
            }
            let (x, spare) = (y.unsigned_abs(), y.unsigned_abs().leading_zeros().min(31));
            let expected = inverse.scale((x >> 1) as i32, q);
            if (33..=62).contains(&(shift + spare as i32)) && expected < 1 << 30 {
                prop_assert_eq!(inverse.scale_positive(x >> 1, q, spare), expected);
            }
        }

        #[test]
        fn reciprocals_of_short_and_long_numbers_are_the_general_one(n in any::<u64>(), bits in 0u32..32) {
            let (short, long) = (((n as u32) >> bits).max(1), (n >> bits).max(1 << 32));
            let by_short = Reciprocal::of_short(short);
            prop_assert_eq!(by_short, Reciprocal::new(u64::from(short)));
            prop_assert_eq!(Reciprocal::of_long(long), Reciprocal::new(long));
            let part = ((n >> 32) as u32 % short) >> 1;
            prop_assert_eq!(by_short.share(part, 24), by_short.scale(part as i32, 24));
            let whole = f64::from(by_short.share(short, 24)) / 2f64.powi(24);
            prop_assert!((whole - 1.0).abs() < 1e-7, "{}", whole);
        }

        #[test]
        fn a_short_quotient_is_exact(n in 0u64..1 << 46, d in 1u32..=1 << 17) {
            prop_assert_eq!(short_quotient(n, d), n / u64::from(d));
        }

        #[test]
        fn a_quotient_is_exact(bits in 0u32..62, low in any::<u64>(), q in 0u64..1 << 31) {
            let d = 1u64 << bits | low & ((1 << bits) - 1);
            for n in [d.saturating_mul(q), d.saturating_mul(q).saturating_add(low % d)] {
                if n < 1 << 63 && n / d < 1 << 31 {
                    prop_assert_eq!(quotient(n, d), (n / d) as i64, "{} / {}", n, d);
                }
            }
        }

        #[test]
        fn reciprocal_is_good_to_nine_digits(bits in 0u32..64, low in any::<u64>()) {
            let n = (1u64 << bits) | (low & ((1u64 << bits) - 1));
            let r = Reciprocal::new(n);
            let value = f64::from(r.mantissa) * 2f64.powi(-r.exponent);
            prop_assert!((value * n as f64 - 1.0).abs() < 2e-9, "1/{} = {}", n, value);
        }

        #[test]
        fn scale_multiplies(x in any::<i32>(), n in 1u64..u64::MAX, q in -10i32..70) {
            let exact = f64::from(x) * 2f64.powi(q) / n as f64;
            let got = f64::from(Reciprocal::new(n).scale(x, q));
            let bounded = exact.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
            prop_assert!((got - bounded).abs() <= 1.0 + 4e-9 * bounded.abs(), "{got} {bounded}");
        }
    }
}
