//! Sine, cosine, hyperbolic tangent and softplus of whole registers, in single precision.
//!
//! Polynomials after argument reduction; errors are absolute ones of about 1e-7, the rounding of
//! values near 1, for arguments up to 1e4 (tested against f64).

use std::f32::consts::{FRAC_1_PI, LOG2_E};

use pulp::Simd;

/// 1.5 * 2^23: adding it rounds to an integer, which then lies in the lowest bits.
const ROUND: f32 = 12_582_912.0;

/// pi as a sum of three numbers, of which the first two have few bits: their products with
/// integers up to 2^11 are exact.
const PI_PARTS: [f32; 3] = [3.140_625, 9.675_026e-4, 1.509_958e-7];

/// ln 2 as a sum of two numbers, of which the first has few bits.
const LN_2_PARTS: [f32; 2] = [0.693_115_23, 3.194_618_3e-5];

/// Taylor coefficients of (sin r)/r in r^2; the next one is below 6e-8 for r up to pi/2.
const SIN: [f32; 6] = [
    1.0,
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5_040.0,
    1.0 / 362_880.0,
    -1.0 / 39_916_800.0,
];

/// Taylor coefficients of cos r in r^2; the next one is below 7e-9.
const COS: [f32; 7] = [
    1.0,
    -0.5,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
    1.0 / 479_001_600.0,
];

/// Taylor coefficients of e^r; the next one is below 2e-7 * r for r up to ln(2)/2.
const EXP: [f32; 7] = [
    1.0,
    1.0,
    0.5,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
];

/// Sum of `coefficients[k] x^k`, by Horner's rule.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(s: S, x: S::f32s, coefficients: [f32; N]) -> S::f32s {
    let mut sum = s.splat_f32s(coefficients[N - 1]);
    for k in (0..N - 1).rev() {
        sum = s.mul_add_e_f32s(sum, x, s.splat_f32s(coefficients[k]));
    }
    sum
}

/// `(sin x, cos x)`: x = k pi + r, both change sign with k.
#[inline(always)]
pub(super) fn sin_cos<S: Simd>(s: S, x: S::f32s) -> (S::f32s, S::f32s) {
    let shifted = s.mul_add_e_f32s(x, s.splat_f32s(FRAC_1_PI), s.splat_f32s(ROUND));
    let k = s.sub_f32s(shifted, s.splat_f32s(ROUND));
    let mut r = x;
    for part in PI_PARTS {
        r = s.mul_add_e_f32s(k, s.splat_f32s(-part), r);
    }
    let square = s.mul_f32s(r, r);
    let sin = s.mul_f32s(r, polynomial(s, square, SIN));
    let cos = polynomial(s, square, COS);
    let bits = s.transmute_u32s_f32s(shifted);
    let odd = s.wrapping_dyn_shl_u32s(bits, s.splat_u32s(31));
    let signed = |y| s.transmute_f32s_u32s(s.xor_u32s(s.transmute_u32s_f32s(y), odd));
    (signed(sin), signed(cos))
}

/// e^x for x in -87..=87.
#[inline(always)]
fn exp<S: Simd>(s: S, x: S::f32s) -> S::f32s {
    let shifted = s.mul_add_e_f32s(x, s.splat_f32s(LOG2_E), s.splat_f32s(ROUND));
    let k = s.sub_f32s(shifted, s.splat_f32s(ROUND));
    let mut r = x;
    for part in LN_2_PARTS {
        r = s.mul_add_e_f32s(k, s.splat_f32s(-part), r);
    }
    // 2^k: k into the exponent bits.
    let bits = s.transmute_u32s_f32s(shifted);
    let exponent = s.wrapping_dyn_shl_u32s(s.add_u32s(bits, s.splat_u32s(127)), s.splat_u32s(23));
    s.mul_f32s(polynomial(s, r, EXP), s.transmute_f32s_u32s(exponent))
}

/// tanh x = 1 - 2 / (e^2x + 1).
#[inline(always)]
pub(super) fn tanh<S: Simd>(s: S, x: S::f32s) -> S::f32s {
    // Beyond 10 the result is 1 to f32's last bit.
    let bounded = s.max_f32s(s.min_f32s(x, s.splat_f32s(10.0)), s.splat_f32s(-10.0));
    let e = exp(s, s.add_f32s(bounded, bounded));
    let one = s.splat_f32s(1.0);
    s.sub_f32s(one, s.div_f32s(s.splat_f32s(2.0), s.add_f32s(e, one)))
}

/// `(ln(1 + e^x), 1 / (1 + e^-x))`: softplus and its slope, in scalars, because they are needed only once per
/// point.
pub(super) fn softplus(x: f32) -> (f32, f32) {
    let e = (-x.abs()).exp();
    let slope = if x < 0.0 {
        e / (1.0 + e)
    } else {
        1.0 / (1.0 + e)
    };
    (x.max(0.0) + e.ln_1p(), slope)
}

#[cfg(test)]
mod tests {
    use pulp::{Arch, Simd, WithSimd};

    use super::*;

    /// sin, cos and tanh of every number of the slice.
    struct All<'a>(&'a [f32]);

    impl WithSimd for All<'_> {
        type Output = Vec<[f32; 3]>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, s: S) -> Self::Output {
            let mut all = Vec::new();
            for &x in self.0 {
                let (sin, cos) = sin_cos(s, s.splat_f32s(x));
                let tanh = tanh(s, s.splat_f32s(x));
                let first = |y| s.reduce_sum_f32s(y) / S::F32_LANES as f32;
                all.push([first(sin), first(cos), first(tanh)]);
            }
            all
        }
    }

    #[test]
    fn elementary_functions_are_those_of_f64_to_single_precision() {
        let arguments: Vec<f32> = (-40_000..=40_000)
            .map(|n| n as f32 * 1.234e-3)
            .chain([0.0, 1e-20, -1e-3, 1e3, -6_000.0])
            .collect();
        let all = Arch::new().dispatch(All(&arguments));
        for (&x, [sin, cos, tanh]) in arguments.iter().zip(all) {
            let exact = f64::from(x);
            assert!(
                (f64::from(sin) - exact.sin()).abs() < 3e-7,
                "sin {x}: {sin}"
            );
            assert!(
                (f64::from(cos) - exact.cos()).abs() < 3e-7,
                "cos {x}: {cos}"
            );
            assert!(
                (f64::from(tanh) - exact.tanh()).abs() < 3e-7,
                "tanh {x}: {tanh}"
            );
        }
    }

    #[test]
    fn softplus_and_its_slope_are_those_of_f64() {
        for n in -60..=60 {
            let x = n as f32 * 0.5;
            let exact = f64::from(x);
            let (value, slope) = softplus(x);
            let expected = exact.max(0.0) + (-exact.abs()).exp().ln_1p();
            assert!((f64::from(value) / expected - 1.0).abs() < 1e-6);
            assert!((f64::from(slope) * (1.0 + (-exact).exp()) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_parts_of_pi_and_ln_2_sum_up() {
        let sum = |parts: &[f32]| parts.iter().map(|p| f64::from(*p)).sum::<f64>();
        assert!((sum(&PI_PARTS) - std::f64::consts::PI).abs() < 1e-12);
        assert!((sum(&LN_2_PARTS) - std::f64::consts::LN_2).abs() < 1e-10);
    }
}
