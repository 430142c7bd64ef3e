//! Clipping: samples at an end of the channel's range.

use ihd_signal::vectorised::vectorised;

/// Bins of the histogram over the range of the samples.
const BINS: f64 = 128.0;

/// Samples in which the smallest step between levels is searched.
const FEW: usize = 4096;

/// Least ratio of samples in the end bin to those in the next one: a sine of constant amplitude has 2.4, one with varying
/// amplitude less than 1.
const PILE: f64 = 5.0;

/// Fewest samples at an end that count as clipping.
const LEAST: usize = 16;

/// Share of full scale from which a sample counts as clipped: a code of 12 bits below it, because the upper end of a
/// converter's range is a code short of it.
const FULL_SCALE: f64 = 1.0 - 1.01 / 2048.0;

/// Clipping of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClippedSamples {
    /// Number of samples at an end of the range.
    pub samples: usize,
    /// Magnitude of the level at which they rest, in the channel's unit.
    pub level: f64,
}

/// Counts samples at the ends of the range: at `full_scale`, in the channel's unit, if it is known, else at levels where
/// they pile up.
pub fn count_clipped(x: &[f32], full_scale: Option<f64>) -> ClippedSamples {
    let (low, high) = extent(x);
    if low >= high || !(high - low).is_finite() {
        return ClippedSamples::default();
    }
    if let Some(full_scale) = full_scale.filter(|f| f.is_finite() && *f > 0.0) {
        let rail = full_scale * FULL_SCALE;
        // The largest magnitude is far from the rail.
        let reached = high.max(-low) >= rail;
        let at_rail = |x: &&f32| f64::from(x.abs()) >= rail;
        let samples = if reached {
            x.iter().filter(at_rail).count()
        } else {
            0
        };
        if samples > 0 {
            return ClippedSamples {
                samples,
                level: full_scale,
            };
        }
    }
    let width = bin_width(x, high - low);
    let mut counts = [[0usize; 2]; 2];
    // Two and a half bins at either end, and the rounding of a sample; values between are in none of these bins.
    let far = (high - 2.5 * width) as f32..=(low + 2.5 * width) as f32;
    for x in x {
        if *x < *far.start() && *x > *far.end() {
            continue;
        }
        let x = f64::from(*x);
        for (counts, distance) in counts.iter_mut().zip([high - x, x - low]) {
            // Half a bin of slack, so that a level lies within its bin.
            let bin = (distance / width + 0.5) as usize;
            if let Some(count) = counts.get_mut(bin) {
                *count += 1;
            }
        }
    }
    let piled = |[end, next]: [usize; 2]| end >= LEAST && end as f64 > PILE * next as f64;
    let mut out = ClippedSamples::default();
    for (counts, level) in counts.into_iter().zip([high, low]) {
        if piled(counts) {
            out.samples += counts[0];
            out.level = out.level.max(level.abs());
        }
    }
    out
}

/// Smallest and largest of the finite samples; infinite with exchanged signs if there are none.
fn extent(x: &[f32]) -> (f64, f64) {
    const LANES: usize = 16;
    let (low, high) = vectorised(
        #[inline(always)]
        || {
            let (mut low, mut high) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
            for x in x.chunks(LANES) {
                for (k, x) in x.iter().enumerate() {
                    // Both comparisons are false for NaN.
                    low[k] = if *x < low[k] { *x } else { low[k] };
                    high[k] = if *x > high[k] { *x } else { high[k] };
                }
            }
            (low, high)
        },
    );
    let low = low.into_iter().fold(f32::INFINITY, f32::min);
    let high = high.into_iter().fold(f32::NEG_INFINITY, f32::max);
    (f64::from(low), f64::from(high))
}

/// Width of a bin: at least the step between the samples' levels, and a whole multiple of it.
fn bin_width(x: &[f32], range: f64) -> f64 {
    let width = range / BINS;
    match level_step(x) {
        Some(step) => (width / step).ceil().max(1.0) * step,
        None => width,
    }
}

/// Smallest step between the levels of some of the samples; `None` if all are equal or one is not finite.
pub(crate) fn level_step(x: &[f32]) -> Option<f64> {
    let stride = (x.len() / FEW).max(1);
    let mut few: Vec<f64> = x.iter().step_by(stride).map(|x| f64::from(*x)).collect();
    few.sort_by(f64::total_cmp);
    let rounding = (few.last()? - few.first()?) * 1e-6;
    let steps = few.windows(2).map(|w| w[1] - w[0]);
    let step = steps
        .filter(|d| *d > rounding)
        .fold(f64::INFINITY, f64::min);
    step.is_finite().then_some(step)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A modulated sine of amplitude 1 in codes of `bits`, cut off at `rail`.
    fn sine(bits: i32, rail: f64, floor: f64) -> Vec<f32> {
        let codes = 2f64.powi(bits - 1);
        (0..200_000)
            .map(|k| {
                let t = f64::from(k);
                let envelope = floor + (1.0 - floor) * (TAU * t / 400_000.0).sin().abs();
                let x = envelope * (TAU * t / 444.4).sin();
                ((x.clamp(-rail, rail) * codes).round() / codes) as f32
            })
            .collect()
    }

    #[test]
    fn a_pile_at_the_end_is_clipping_and_a_crest_is_none() {
        for bits in [6, 8, 12, 16] {
            for floor in [0.0, 1.0] {
                let clean = count_clipped(&sine(bits, 2.0, floor), None);
                assert_eq!(clean.samples, 0, "{bits} {floor}: {clean:?}");
                let x = sine(bits, 0.8, floor);
                let flat = count_clipped(&x, None);
                let truth = x.iter().filter(|x| x.abs() > 0.799 - 1.0 / 128.0).count();
                assert!(
                    flat.samples > 0 && flat.samples.abs_diff(truth) < truth / 5,
                    "{bits} {floor}: {flat:?} {truth}"
                );
                assert!((flat.level - 0.8).abs() < 0.03, "{flat:?}");
            }
        }
    }

    #[test]
    fn a_known_range_needs_no_pile() {
        let mut x = sine(12, 2.0, 0.0);
        x.iter_mut().for_each(|x| *x *= 0.5);
        assert_eq!(count_clipped(&x, Some(1.0)).samples, 0);
        x[500] = 1.0;
        x[700] = -1.0;
        x[900] = 2047.0 / 2048.0;
        assert_eq!(count_clipped(&x, Some(1.0)).samples, 3);
    }
}
