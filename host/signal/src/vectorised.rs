//! Loops compiled for the processor's instruction set.

use pulp::{Arch, Simd, WithSimd};

/// Runs `f` compiled for all instructions that `pulp` detects. All functions that `f` calls must be inlined, and so must `f`
/// itself, `#[inline(always)] || …`; otherwise they use only the oldest instructions.
///
/// Sums that must have the same digits everywhere need a fixed number of partial sums, with an explicit `mul_add` or without
/// any.
#[inline(always)]
pub fn vectorised<R>(f: impl FnMut() -> R) -> R {
    Arch::new().dispatch(Loops(f))
}

/// Scalar product as eight partial sums, which the compiler can vectorise; the digits are the same for any instructions.
pub fn dot<T: Copy + Into<f64>>(a: &[f64], b: &[T]) -> f64 {
    let mut sums = [0.0; 8];
    for (a, b) in a.chunks(8).zip(b.chunks(8)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * (*b).into();
        }
    }
    sums.iter().sum()
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
    use super::vectorised;

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
