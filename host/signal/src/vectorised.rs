//! Loops compiled for the processor's instruction set.

use std::f64::consts::FRAC_1_SQRT_2;

use pulp::{Arch, Simd, WithSimd};

/// Runs `f` compiled for all instructions that `pulp` detects. All functions that `f` calls must be inlined, and so must `f`
/// itself, `#[inline(always)] || …`; otherwise they use only the oldest instructions.
///
/// One loop for each sum: of two sums in one loop the compiler makes pairs of numbers instead of long vectors.
///
/// Sums that must have the same digits everywhere need a fixed number of partial sums, with an explicit `mul_add` or without
/// any.
#[inline(always)]
pub fn vectorised<R>(f: impl FnMut() -> R) -> R {
    Arch::new().dispatch(Loops(f))
}

/// Scalar product as sixteen partial sums, for use within [`vectorised`]; the digits are the same for any instructions.
///
/// With eight, each addition would wait for the one before.
#[inline(always)]
pub fn dot<T: Copy + Into<f64>>(a: &[f64], b: &[T]) -> f64 {
    let length = a.len().min(b.len());
    let (a, a_rest) = a[..length].as_chunks::<16>();
    let (b, b_rest) = b[..length].as_chunks::<16>();
    let mut sums = [0.0; 16];
    for (a, b) in a.iter().zip(b) {
        for k in 0..16 {
            sums[k] += a[k] * b[k].into();
        }
    }
    let mut sums: [f64; 8] = std::array::from_fn(|k| sums[k] + sums[k + 8]);
    let (a, a_rest) = a_rest.as_chunks::<8>();
    let (b, b_rest) = b_rest.as_chunks::<8>();
    for (a, b) in a.iter().zip(b) {
        for k in 0..8 {
            sums[k] += a[k] * b[k].into();
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(a_rest).zip(b_rest) {
        *sum += a * (*b).into();
    }
    added(sums)
}

/// Sum of eight numbers: the halves are added, then the halves of what that gives.
#[inline(always)]
fn added(x: [f64; 8]) -> f64 {
    let x: [f64; 4] = std::array::from_fn(|k| x[k] + x[k + 4]);
    (x[0] + x[2]) + (x[1] + x[3])
}

/// Sum as eight partial sums, for use within [`vectorised`]; the digits are the same for any instructions.
#[inline(always)]
pub fn sum<T: Copy + Into<f64>>(x: &[T]) -> f64 {
    let (whole, rest) = x.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for x in whole {
        for k in 0..8 {
            sums[k] += x[k].into();
        }
    }
    for (sum, x) in sums.iter_mut().zip(rest) {
        *sum += (*x).into();
    }
    added(sums)
}

/// Least and largest number, for use within [`vectorised`]; infinite with exchanged signs if there are none. NaN is passed over: both
/// comparisons are false for it.
#[inline(always)]
pub fn extremes(x: &[f32]) -> (f32, f32) {
    const LANES: usize = 16;
    let (mut low, mut high) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
    let (whole, rest) = x.as_chunks::<LANES>();
    for x in whole {
        for k in 0..LANES {
            low[k] = if x[k] < low[k] { x[k] } else { low[k] };
        }
        for k in 0..LANES {
            high[k] = if x[k] > high[k] { x[k] } else { high[k] };
        }
    }
    let low = low.iter().chain(rest).copied();
    let high = high.iter().chain(rest).copied();
    (
        low.fold(f32::INFINITY, f32::min),
        high.fold(f32::NEG_INFINITY, f32::max),
    )
}

/// ln 2 in two parts, the first with 21 zeros at its end.
pub const LN_2: (f64, f64) = (6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10);

/// Natural logarithm of a positive normal number to 3e-16 of its size or, near 1, of 1; without branches, for use within
/// [`vectorised`].
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    /// Terms of the series; the remainder is below 1e-17.
    const TERMS: usize = 11;
    let bits = x.to_bits();
    let exponent = bits.wrapping_sub(FRAC_1_SQRT_2.to_bits()) as i64 >> 52;
    // From √½ to √2.
    let mantissa = f64::from_bits(bits.wrapping_sub((exponent << 52) as u64));
    // ln m = 2 artanh s.
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let square = s * s;
    let mut sum = 0.0;
    for k in (0..TERMS).rev() {
        sum = square.mul_add(sum, 2.0 / (2 * k + 1) as f64);
    }
    let whole = exponent as f64;
    whole.mul_add(LN_2.0, whole.mul_add(LN_2.1, s * sum))
}

struct Loops<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Loops<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

#[cfg(test)]
mod tests {
    use super::{dot, extremes, ln, sum, vectorised};

    #[test]
    fn sums_and_products_leave_no_sample_out() {
        let x: Vec<f64> = (1..=45).map(f64::from).collect();
        for n in [0, 1, 7, 8, 9, 45] {
            let whole = n as f64;
            assert_eq!(sum(&x[..n]), 0.5 * whole * (whole + 1.0));
            assert_eq!(
                dot(&x[..n], &x),
                whole * (whole + 1.0) * (2.0 * whole + 1.0) / 6.0
            );
        }
    }

    #[test]
    fn extremes_are_found_anywhere_and_what_is_no_number_is_none() {
        assert_eq!(extremes(&[]), (f32::INFINITY, f32::NEG_INFINITY));
        for n in [1, 16, 37] {
            for k in 0..n {
                let mut x = vec![f32::NAN; n];
                x[k] = -2.0;
                assert_eq!(extremes(&x), (-2.0, -2.0));
                x[n - 1 - k] = 3.0;
                assert_eq!(extremes(&x).1, 3.0);
            }
        }
    }

    #[test]
    fn ln_is_the_logarithm() {
        for k in -3000..3000 {
            let x = (f64::from(k) * 0.05).exp2();
            for x in [x, 1.0 + x * 1e-9] {
                let right = x.ln();
                assert!((ln(x) - right).abs() <= 3e-16 * right.abs().max(1.0), "{x}");
            }
        }
    }

    #[test]
    fn what_is_run_is_run_once_and_answers() {
        let mut x = [1.0_f64, 2.0, 3.0];
        let sum = vectorised(
            #[inline(always)]
            || {
                x.iter_mut().for_each(|x| *x = x.mul_add(2.0, 1.0));
                x.iter().sum::<f64>()
            },
        );
        assert_eq!((x, sum), ([3.0, 5.0, 7.0], 15.0));
    }
}
