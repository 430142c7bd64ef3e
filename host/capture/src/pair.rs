//! Combination of two files of one acquisition, one channel each, on one time axis.

use std::ops::Range;

use ihd_signal::TimeBase;

/// Largest difference between the grids, in sampling intervals, and in seconds: 1 ns costs less than 0.1 % of R (20 ns cost 1 to 1.8 %).
const SKEW: f64 = 0.05;
const SKEW_S: f64 = 1e-9;

/// Index ranges of the samples in both files that lie at the same times.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlap {
    /// Samples of the first file.
    pub first: Range<usize>,
    /// Samples of the second file; as many.
    pub second: Range<usize>,
}

/// Finds the samples that two files have in common.
///
/// # Errors
/// What differs: rate, place of the samples, or the whole time.
pub fn overlap(
    (a, a_samples): (&TimeBase, usize),
    (b, b_samples): (&TimeBase, usize),
) -> Result<Overlap, String> {
    match (a, b) {
        (
            TimeBase::Even { t0_s: a0, dt_s },
            TimeBase::Even {
                t0_s: b0,
                dt_s: b_dt,
            },
        ) => {
            let longest = a_samples.max(b_samples) as f64;
            if (b_dt / dt_s - 1.0).abs() * longest > SKEW {
                let rates = (1.0 / dt_s, 1.0 / b_dt);
                return Err(format!("{} S/s and {} S/s", rates.0, rates.1));
            }
            let shift = (b0 - a0) / dt_s;
            let whole = libm::round(shift);
            // Times near a second have no more digits.
            let rounding_s = 4.0 * f64::EPSILON * a0.abs().max(b0.abs());
            if (shift - whole).abs() > SKEW.min((SKEW_S + rounding_s) / dt_s) {
                return Err(format!(
                    "the samples of the one lie {:.3} of an interval beside the other's, which would be a skew: export both channels of \
                     one acquisition, or one file of both",
                    shift - whole
                ));
            }
            common(whole, a_samples, b_samples)
                .ok_or_else(|| format!("they begin at {a0:e} s and {b0:e} s, without overlap"))
        }
        (TimeBase::Stamps(a), TimeBase::Stamps(b)) if a.len() == b.len() => {
            let near = |k: usize| {
                let interval = a
                    .get(k + 1)
                    .or(a.last())
                    .zip(a.get(k))
                    .map_or(0.0, |(n, t)| n - t);
                (a[k] - b[k]).abs() <= SKEW * interval.max(f64::EPSILON * a[k].abs())
            };
            match (0..a.len().saturating_sub(1)).find(|k| !near(*k)) {
                Some(k) => Err(format!("sample {k} is at {:e} s and at {:e} s", a[k], b[k])),
                None => Ok(Overlap {
                    first: 0..a.len(),
                    second: 0..b.len(),
                }),
            }
        }
        _ => Err("uneven sampling times that differ".to_owned()),
    }
}

/// Overlap of two even grids, the second `shift` samples after the first.
fn common(shift: f64, a_samples: usize, b_samples: usize) -> Option<Overlap> {
    let (a_from, b_from) = (shift.max(0.0), (-shift).max(0.0));
    let left = |samples: usize, from: f64| samples as f64 - from;
    let length = left(a_samples, a_from).min(left(b_samples, b_from));
    if length < 2.0 {
        return None;
    }
    let (a_from, b_from, length) = (a_from as usize, b_from as usize, length as usize);
    Some(Overlap {
        first: a_from..a_from + length,
        second: b_from..b_from + length,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(t0_s: f64, dt_s: f64) -> TimeBase {
        TimeBase::Even { t0_s, dt_s }
    }

    #[test]
    fn the_common_part_of_shifted_files() {
        let (a, b) = (even(0.0, 2e-8), even(6e-8, 2e-8));
        let both = overlap((&a, 10), (&b, 10)).unwrap();
        assert_eq!((both.first, both.second), (3..10, 0..7));
        let both = overlap((&b, 10), (&a, 5)).unwrap();
        assert_eq!((both.first, both.second), (0..2, 3..5));
        assert!(overlap((&a, 4), (&b, 10)).unwrap_err().contains("overlap"));
    }

    /// A twentieth of an interval is 1 ns at 50 MS/s, and 50 ns at 1 MS/s.
    #[test]
    fn a_skew_is_refused_by_its_time() {
        for (dt_s, skew_s, is_taken) in [
            (2e-8, 0.9e-9, true),
            (2e-8, 1.1e-9, false),
            (1e-6, 0.9e-9, true),
            (1e-6, 2e-9, false),
        ] {
            let both = overlap((&even(0.0, dt_s), 100), (&even(skew_s, dt_s), 100));
            assert_eq!(both.is_ok(), is_taken, "{dt_s} {skew_s}");
        }
    }

    #[test]
    fn another_rate_or_place_is_refused() {
        let a = even(0.0, 2e-8);
        assert!(
            overlap((&a, 10), (&even(0.0, 4e-8), 10))
                .unwrap_err()
                .contains("S/s")
        );
        // A rate off by 1e-6 matters over a million samples, not over a thousand.
        let near = even(0.0, 2e-8 * (1.0 + 1e-6));
        assert!(overlap((&a, 1000), (&near, 1000)).is_ok());
        assert!(overlap((&a, 1_000_000), (&near, 1_000_000)).is_err());
        assert!(
            overlap((&a, 10), (&even(1e-8, 2e-8), 10))
                .unwrap_err()
                .contains("0.5")
        );
        let (s, t) = (
            TimeBase::Stamps(vec![0.0, 1.0, 3.0]),
            TimeBase::Stamps(vec![0.0, 1.5, 3.0]),
        );
        assert!(overlap((&s, 3), (&s, 3)).is_ok());
        assert!(overlap((&s, 3), (&t, 3)).unwrap_err().contains("sample 1"));
        assert!(overlap((&s, 3), (&a, 3)).is_err());
    }
}
