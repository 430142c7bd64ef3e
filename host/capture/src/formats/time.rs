//! Names of time columns, and conversion of their stamps to a time base: even if the stamps are even within their resolution.

use ihd_signal::TimeBase;

/// Largest deviation from an even grid, as a fraction of the sampling interval.
const MAX_JITTER: f64 = 1e-3;

/// Names of a time column or vector without its unit, in lower case.
const NAMES: [&str; 6] = ["time", "t", "x", "x-axis", "timestamp", "zeit"];

/// Returns `true` if a column or vector of this name, without its unit, is the time.
pub fn is_time_name(name: &str) -> bool {
    NAMES.contains(&name.to_lowercase().as_str())
}

/// Error for stamps that give no time base.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StampsError {
    /// They do not ascend.
    #[error(
        "time does not ascend: sample {sample} is at {t_s:e} s, the one before at {before_s:e} s"
    )]
    NotAscending {
        /// Index of the sample whose time is not later than the one before.
        sample: usize,
        /// Time of the preceding sample, in seconds.
        before_s: f64,
        /// Time of the sample, in seconds.
        t_s: f64,
    },
    /// They are rounded so much that the rate is unknown.
    #[error(
        "times rounded to {resolution_s:e} s leave the sampling rate uncertain by {:.1} %, and L with it: give the rate, as in --input \
         rate=50M, or write more digits",
        100.0 * share
    )]
    Coarse {
        /// Place of the last digit, in seconds.
        resolution_s: f64,
        /// Uncertainty of the rate.
        share: f64,
    },
}

impl StampsError {
    /// Index of the sample at which it shows.
    pub fn sample(&self) -> usize {
        match self {
            Self::NotAscending { sample, .. } => *sample,
            Self::Coarse { .. } => 0,
        }
    }
}

/// Resolution of stamps that were written in decimals, in their unit: the place of the last digit of the largest, which has the most.
pub fn decimal_resolution(stamps: &[f64], significant_digits: usize) -> f64 {
    let largest = largest(stamps);
    if largest == 0.0 || significant_digits == 0 {
        return 0.0;
    }
    let places = significant_digits.min(300) as i32 - 1;
    10f64.powi(largest.log10().floor() as i32 - places)
}

/// Resolution of stamps that are all single-precision numbers, in their unit; 0 of others. A program that adds in single precision rounds
/// twice.
pub fn binary_resolution(stamps: &[f64]) -> f64 {
    single_resolution(stamps, |t| f64::from(*t as f32) == *t)
}

/// Resolution of stamps that were written in decimals, perhaps from single-precision numbers, in their unit.
pub fn written_resolution(stamps: &[f64], significant_digits: usize) -> f64 {
    // The fewest decimals, as Python and pandas write them; nine, as C's %.9g does.
    let is_single = |t: &f64| {
        let single = *t as f32;
        let texts = [single.to_string(), format!("{single:.8e}")];
        texts.iter().any(|text| text.parse() == Ok(*t))
    };
    let single = match significant_digits {
        // Decimals with fewer digits are as coarse as the number.
        8 | 9 => single_resolution(stamps, is_single),
        _ => binary_resolution(stamps),
    };
    single.max(decimal_resolution(stamps, significant_digits))
}

fn single_resolution(stamps: &[f64], is_single: impl Fn(&f64) -> bool) -> f64 {
    match stamps.iter().all(is_single) {
        true => 2.0 * f64::from(f32::EPSILON) * largest(stamps),
        false => 0.0,
    }
}

fn largest(stamps: &[f64]) -> f64 {
    let ends = stamps.first().into_iter().chain(stamps.last());
    ends.fold(0.0, |most, t| most.max(t.abs()))
}

/// Largest uncertainty of the rate: L is proportional to the interval, and right within .7 %.
const MAX_RATE_SHARE: f64 = 5e-3;

/// Finds the time base of finite stamps in seconds, at least two of them.
///
/// Stamps may be rounded to multiples of `resolution_s` (0: exact), so that two of them can be
/// equal; they count as even when all lie within it (the first and the k-th may be off by half of it
/// each), or a thousandth of the interval, of an even grid. `declared_s`, the interval that
/// the file states, is taken where it is as good as the one from the first to the last stamp.
///
/// # Errors
/// [`StampsError`] for stamps that are neither even nor ascending, or whose interval is unknown.
pub fn time_base(
    stamps: Vec<f64>,
    resolution_s: f64,
    declared_s: Option<f64>,
) -> Result<TimeBase, StampsError> {
    let (Some(&first), Some(&last)) = (stamps.first(), stamps.last()) else {
        return Ok(TimeBase::Stamps(stamps));
    };
    let intervals = stamps.len().saturating_sub(1).max(1) as f64;
    let mean_s = (last - first) / intervals;
    // Rounding makes stamps equal but never reverses them.
    let descends = stamps.windows(2).any(|pair| pair[1] < pair[0]);
    for dt_s in declared_s.into_iter().chain([mean_s]) {
        let rounding = 4.0 * f64::EPSILON * first.abs().max(last.abs());
        let tolerance = resolution_s.max(MAX_JITTER * dt_s) + rounding;
        let even = |(k, t): (usize, &f64)| (t - first - k as f64 * dt_s).abs() <= tolerance;
        // A step is off by the rounding of both its ends; the mean interval, by that of the first and the last stamp.
        let of_step = (1.0 + 1.0 / intervals) * resolution_s;
        let of_step = of_step.max(2.0 * MAX_JITTER * dt_s) + rounding;
        let steady = |pair: &[f64]| (pair[1] - pair[0] - dt_s).abs() <= of_step;
        let is_even = || stamps.iter().enumerate().all(even) && stamps.windows(2).all(steady);
        if dt_s > 0.0 && !descends && is_even() {
            let share = resolution_s / (last - first);
            // Digits that are all there are rounded by nothing, however few.
            let off = |(k, t): (usize, &f64)| (t - first - k as f64 * dt_s).abs();
            let is_rounded = || {
                stamps
                    .iter()
                    .enumerate()
                    .map(off)
                    .any(|off| off > 0.1 * resolution_s)
            };
            if share > MAX_RATE_SHARE && declared_s != Some(dt_s) && is_rounded() {
                return Err(StampsError::Coarse {
                    resolution_s,
                    share,
                });
            }
            return Ok(TimeBase::Even { t0_s: first, dt_s });
        }
    }
    let not_later = stamps.windows(2).position(|pair| pair[1] <= pair[0]);
    match not_later {
        Some(k) => Err(StampsError::NotAscending {
            sample: k + 1,
            before_s: stamps[k],
            t_s: stamps[k + 1],
        }),
        None => Ok(TimeBase::Stamps(stamps)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_stamps_of_an_even_grid_are_even() {
        // 4 ns written with a resolution of 10 ns: every third stamp repeats the one before.
        let stamps: Vec<f64> = (0..1000)
            .map(|k| (f64::from(k) * 4e-9 / 1e-8).round() * 1e-8)
            .collect();
        let time = time_base(stamps.clone(), 1e-8, Some(4e-9)).unwrap();
        assert_eq!(
            time,
            TimeBase::Even {
                t0_s: 0.0,
                dt_s: 4e-9
            }
        );
        let Ok(TimeBase::Even { dt_s, .. }) = time_base(stamps, 1e-8, None) else {
            panic!("even");
        };
        assert!((dt_s / 4e-9 - 1.0).abs() < 1e-2, "{dt_s}");
    }

    /// 0 to 20 ms in steps of 100 ns, with 5 ms missing, as Python, `%g` and a scope write them.
    #[test]
    fn a_gap_is_seen_however_the_stamps_are_written() {
        let even: Vec<f64> = (0..200_000).map(|k| f64::from(k) * 1e-7).collect();
        let (head, tail) = (&even[..80_000], &even[130_000..]);
        let gap = [head, tail].concat();
        for (digits, resolution_s) in [(17, 1e-18), (6, 1e-7), (9, 1e-10)] {
            let found_s = decimal_resolution(&gap, digits);
            assert!((found_s / resolution_s - 1.0).abs() < 1e-12, "{found_s}");
            let rounded = |all: &[f64]| -> Vec<f64> {
                let round = |t: &f64| (t / found_s).round() * found_s;
                all.iter().map(round).collect()
            };
            let base = time_base(rounded(&even), found_s, None);
            assert!(matches!(base, Ok(TimeBase::Even { .. })), "{digits}");
            let base = time_base(rounded(&gap), found_s, None);
            assert!(matches!(base, Ok(TimeBase::Stamps(_))), "{digits}");
        }
    }

    /// Whole microseconds at 1 MS/s: a step of 2 µs may be one of 1 µs, rounded; one of 3 µs may not.
    #[test]
    fn two_samples_missing_among_coarse_stamps_are_seen() {
        for (missing, is_even) in [(0, true), (1, true), (2, false)] {
            let late = |k: i32| f64::from(k + if k < 5000 { 0 } else { missing });
            let stamps: Vec<f64> = (0..10_000)
                .map(|k| (1e-6 * late(k) / 1e-6).round() * 1e-6)
                .collect();
            for declared_s in [None, Some(1e-6)] {
                let base = time_base(stamps.clone(), 1e-6, declared_s);
                assert_eq!(
                    matches!(base, Ok(TimeBase::Even { .. })),
                    is_even,
                    "{missing}"
                );
            }
        }
    }

    #[test]
    fn decimals_of_single_precision_are_recognised_and_others_not() {
        let times = || (0..20_000).map(|k| -2e-3 + f64::from(k) * 1.2345678e-7);
        let parsed = |text: String| text.parse::<f64>().unwrap();
        let fewest = times().map(|t| parsed((t as f32).to_string()));
        let of_nine = times().map(|t| parsed(format!("{:.8e}", t as f32)));
        let all = times().map(|t| parsed(format!("{:.18e}", t as f32)));
        for (stamps, digits) in [
            (fewest.collect::<Vec<_>>(), 9),
            (of_nine.collect(), 9),
            (all.collect(), 19),
        ] {
            let resolution_s = written_resolution(&stamps, digits);
            assert!((4e-10..6e-10).contains(&resolution_s), "{digits}");
        }
        for digits in [5, 8, 9] {
            let double: Vec<f64> = times()
                .map(|t| parsed(format!("{t:.*e}", digits - 1)))
                .collect();
            let resolution_s = written_resolution(&double, digits);
            assert_eq!(resolution_s, decimal_resolution(&double, digits));
        }
    }

    #[test]
    fn single_precision_rounds_stamps_by_up_to_a_few_percent_of_an_interval() {
        let single = |k: i32| f64::from((f64::from(k) * 1e-7) as f32);
        let stamps: Vec<f64> = (0..200_000).map(single).collect();
        let resolution_s = binary_resolution(&stamps);
        assert!((3.6e-9..6e-9).contains(&resolution_s), "{resolution_s}");
        let base = time_base(stamps, resolution_s, None);
        assert!(matches!(base, Ok(TimeBase::Even { .. })));
        assert_eq!(binary_resolution(&[0.0, 1e-7]), 0.0);
    }

    #[test]
    fn a_gap_stays_and_a_wrong_interval_is_not_believed() {
        let gap = vec![0.0, 1.0, 2.0, 5.0, 6.0];
        assert_eq!(
            time_base(gap.clone(), 0.0, Some(1.0)),
            Ok(TimeBase::Stamps(gap))
        );
        let even = vec![0.0, 1.0, 2.0, 3.0];
        let time = time_base(even, 0.0, Some(0.5)).unwrap();
        assert_eq!(
            time,
            TimeBase::Even {
                t0_s: 0.0,
                dt_s: 1.0
            }
        );
    }

    /// 20 MS/s from 14.049 ms on, as a spreadsheet with three digits saves it.
    #[test]
    fn stamps_so_coarse_that_the_rate_is_unknown_are_refused() {
        let stamps = |count: u32, resolution_s: f64| -> Vec<f64> {
            let exact = (0..count).map(|k| 14.049e-3 + f64::from(k) * 5e-8);
            exact
                .map(|t| (t / resolution_s).round() * resolution_s)
                .collect()
        };
        // 1.9 ms and 6 ms.
        let short = time_base(stamps(38_000, 1e-5), 1e-5, None);
        assert!(
            matches!(short, Err(StampsError::Coarse { .. })),
            "{short:?}"
        );
        let long = time_base(stamps(120_000, 1e-5), 1e-5, None);
        let Ok(TimeBase::Even { dt_s, .. }) = long else {
            panic!("even");
        };
        assert!((dt_s / 5e-8 - 1.0).abs() < MAX_RATE_SHARE);
        // What the file states of its interval is no rounded number.
        assert!(time_base(stamps(38_000, 1e-5), 1e-5, Some(5e-8)).is_ok());
    }

    #[test]
    fn stamps_that_go_back_are_refused_by_number() {
        let back = StampsError::NotAscending {
            sample: 2,
            before_s: 1.0,
            t_s: 0.5,
        };
        assert_eq!(time_base(vec![0.0, 1.0, 0.5, 3.0], 0.0, None), Err(back));
        assert!(time_base(vec![0.0, -1.0], 0.0, None).is_err());
        // Within the resolution of an even grid, and yet a table that was pasted twice.
        assert!(time_base(vec![0.0, 1e-3, 0.0, 1e-3], 1e-3, None).is_err());
        assert!(time_base(vec![0.0, 0.0, 0.0], 0.0, Some(1.0)).is_err());
    }
}
