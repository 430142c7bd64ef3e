//! Loops compiled for the instruction set at hand.

use pulp::{Arch, Simd, WithSimd};

/// Runs `f` where the compiler may use all instructions that `pulp` finds: what `f` calls must be inlined, and so must
/// `f` itself, `#[inline(always)] || …`, or it stays with the oldest ones.
///
/// Sums that are to have the same digits everywhere go into a fixed number of partial sums, with an explicit
/// `mul_add` or with none.
#[inline(always)]
pub fn vectorised<R>(f: impl FnMut() -> R) -> R {
    Arch::new().dispatch(Loops(f))
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
