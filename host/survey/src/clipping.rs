//! Clipping: samples at an end of the channel's range.

use ihd_signal::vectorised::{extremes, vectorised};

/// Bins of the histogram over the range of the samples.
const BINS: f64 = 128.0;

/// Samples in which the smallest step between levels is searched.
const STEP_SEARCH_SAMPLES: usize = 4096;

/// Least ratio of samples in the end bin to those in the next one: a sine of constant amplitude has 2.4, one with varying
/// amplitude less than 1.
const MIN_PILE_RATIO: f64 = 5.0;

/// Fine bins in a bin: of 12 bits, one code.
const FINE_BINS: usize = 32;

/// Fewest samples at an end that count as clipping.
const MIN_CLIPPED_SAMPLES: usize = 16;

/// Share of full scale from which a sample counts as clipped: a code of 12 bits below it, because the upper end of a
/// converter's range is a code short of it.
const FULL_SCALE: f64 = 1.0 - 1.01 / 2048.0;

/// SNR in decibel below which noise may reach the ends of the range.
const TAILS_BELOW_DB: f64 = 20.0;

/// Fewest samples of a switching period with which clipping is judged and restored: a clipped crest has more than one sample at the
/// end of the range, and most of a current's 31 harmonics do not fold onto one another.
pub const MIN_PER_PERIOD: f64 = 16.0;

/// Share of clipped samples followed by another one, above which the signal itself clips: the probability that noise reaches an end
/// that is 1.3 deviations away.
const MAX_FOLLOWED_SHARE: f64 = 0.1;

/// Mean excess of such a noise beyond the end, in deviations.
const MEAN_EXCESS_SIGMAS: f64 = 0.47;

/// Ratio of clipped samples at the mains' crest to their mean.
const AT_CREST: f64 = 4.0;

/// Share of the amplitude that noise may lose at the ends and is no fault: half of what R may be off.
const MAX_NOISE_SHARE: f64 = 5e-3;

/// Clipping of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClippedSamples {
    /// Number of samples at an end of the range.
    pub samples: usize,
    /// Levels at which they rest.
    pub rails: Rails,
}

/// Levels at which a channel rests, in its unit; the ends of its range need not be equally far from zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rails {
    /// Level at the lower end; `None` if the channel does not rest there.
    pub low: Option<f64>,
    /// Level at the upper end; `None` if the channel does not rest there.
    pub high: Option<f64>,
}

impl Rails {
    /// Largest magnitude of the levels; 0 without one.
    pub fn level(&self) -> f64 {
        let levels = self.low.into_iter().chain(self.high);
        levels.map(f64::abs).fold(0.0, f64::max)
    }

    /// Levels as text, the lower one first, with the symbol of their unit.
    pub fn in_words(&self, unit: &str) -> String {
        let levels = self.low.into_iter().chain(self.high);
        let levels: Vec<String> = levels.map(|level| format!("{level:.4}")).collect();
        format!("{} {unit}", levels.join(" and "))
    }

    /// Values from which a sample counts as clipped, downwards and upwards; `share` is their share of the levels. Infinite without a level.
    pub fn reached_from(&self, share: f64) -> (f64, f64) {
        let margin = |level: f64| (1.0 - share) * level.abs();
        (
            self.low.map_or(f64::NEG_INFINITY, |low| low + margin(low)),
            self.high.map_or(f64::INFINITY, |high| high - margin(high)),
        )
    }
}

impl ClippedSamples {
    /// Returns `true` if only noise reaches the ends of the range, and what it loses there does not matter: with isolated samples,
    /// the signal's crest is 1.3 deviations below the end, and n of N samples lose 2 n/N · 0.47 σ of the amplitude. `snr_db` is the
    /// channel's, `per_period` the samples of a switching period.
    pub fn are_tails_of_noise(&self, x: &[f32], snr_db: f64, per_period: f64) -> bool {
        if self.samples == 0 || snr_db > TAILS_BELOW_DB || per_period < MIN_PER_PERIOD {
            return false;
        }
        let (low, high) = self.rails.reached_from(FULL_SCALE);
        let at_end = |x: f32| f64::from(x) <= low || f64::from(x) >= high;
        let clipped = x.iter().filter(|x| at_end(**x)).count() as f64;
        let followed = x
            .windows(2)
            .filter(|x| at_end(x[0]) && at_end(x[1]))
            .count() as f64;
        // The amplitude in deviations: √2 of the signal's rms.
        let amplitude = std::f64::consts::SQRT_2 * 10f64.powf(snr_db / 20.0);
        let lost = AT_CREST * 2.0 * clipped / x.len() as f64 * MEAN_EXCESS_SIGMAS / amplitude;
        followed < MAX_FOLLOWED_SHARE * clipped && lost < MAX_NOISE_SHARE
    }
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
            let rails = Rails {
                low: (low <= -rail).then_some(-full_scale),
                high: (high >= rail).then_some(full_scale),
            };
            return ClippedSamples { samples, rails };
        }
    }
    let width = bin_width(x, high - low);
    let mut ends = [RangeEnd::EMPTY; 2];
    // Two and a half bins at either end, and the rounding of a sample; values between are in none of these bins.
    let far = (high - 2.5 * width) as f32..=(low + 2.5 * width) as f32;
    let between = |x: &f32| (*x < *far.start()) & (*x > *far.end());
    for block in x.chunks(BLOCK_SAMPLES) {
        let all_between = vectorised(
            #[inline(always)]
            || block.iter().fold(true, |all, x| all & between(x)),
        );
        if all_between {
            continue;
        }
        for x in block.iter().filter(|x| !between(x)) {
            let x = f64::from(*x);
            for (end, distance) in ends.iter_mut().zip([high - x, x - low]) {
                end.count(distance / width);
            }
        }
    }
    let [at_high, at_low] = ends.map(|end| end.clipped());
    ClippedSamples {
        samples: at_high + at_low,
        rails: Rails {
            low: (at_low > 0).then_some(low),
            high: (at_high > 0).then_some(high),
        },
    }
}

/// Samples that are compared with both ends together: in most blocks none is near one.
const BLOCK_SAMPLES: usize = 256;

/// Histogram at an end of the range.
struct RangeEnd {
    /// Samples in the end bin and in the next one.
    bins: [usize; 2],
    /// Samples in the fine bins of both: a channel that clips a few percent of its crests, without noise behind it, piles up in the
    /// first of them alone.
    fine: [usize; 2 * FINE_BINS],
}

impl RangeEnd {
    const EMPTY: Self = Self {
        bins: [0; 2],
        fine: [0; 2 * FINE_BINS],
    };

    /// Counts a sample at a distance from the end, in bins.
    fn count(&mut self, distance: f64) {
        // Half a bin of slack, so that a level lies within its bin.
        if let Some(count) = self.bins.get_mut((distance + 0.5) as usize) {
            *count += 1;
        }
        if let Some(count) = self
            .fine
            .get_mut((distance * FINE_BINS as f64 + 0.5) as usize)
        {
            *count += 1;
        }
    }

    /// Number of samples in a pile at the end; 0 if there is none.
    fn clipped(&self) -> usize {
        let piled = |end: usize, beside: usize| {
            end >= MIN_CLIPPED_SAMPLES && end as f64 > MIN_PILE_RATIO * beside as f64
        };
        let [end, next] = self.bins;
        let [first, rest @ ..] = &self.fine;
        // A pattern that repeats has as many samples at other levels.
        let most = rest.iter().copied().max().unwrap_or(0);
        if piled(end, next) {
            end
        } else if piled(*first, most) {
            *first
        } else {
            0
        }
    }
}

/// Smallest and largest sample; infinite with exchanged signs if there are none.
fn extent(x: &[f32]) -> (f64, f64) {
    let (low, high) = vectorised(
        #[inline(always)]
        || extremes(x),
    );
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
    let stride = (x.len() / STEP_SEARCH_SAMPLES).max(1);
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

    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

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
                let (low, high) = (flat.rails.low.unwrap(), flat.rails.high.unwrap());
                assert!(
                    (high - 0.8).abs() < 0.03 && (low + 0.8).abs() < 0.03,
                    "{flat:?}"
                );
            }
        }
    }

    #[test]
    fn each_end_has_its_own_level() {
        let full = sine(12, 2.0, 0.0);
        let clipped = |low: f32, high: f32| {
            let x: Vec<f32> = full.iter().map(|x| x.clamp(low, high)).collect();
            count_clipped(&x, None).rails
        };
        let near = |level: Option<f64>, right: f64| (level.unwrap() - right).abs() < 1e-3;
        let both = clipped(-0.85, 0.75);
        assert!(near(both.low, -0.85) && near(both.high, 0.75), "{both:?}");
        assert!((both.level() - 0.85).abs() < 1e-3);
        let upper = clipped(-2.0, 0.75);
        assert!(upper.low.is_none() && near(upper.high, 0.75), "{upper:?}");
    }

    /// Three percent off the highest crests, as a rail in front of the converter cuts them; 8 bits are too coarse for so little.
    #[test]
    fn a_few_percent_of_the_crests_are_seen_and_a_repeated_pattern_is_none() {
        for bits in [10, 12, 16] {
            let x = sine(bits, 0.97, 0.0);
            let top = x.iter().copied().fold(0.0, f32::max);
            let truth = x.iter().filter(|x| x.abs() >= top).count();
            let found = count_clipped(&x, None);
            assert!(
                truth > 100 && found.samples >= truth,
                "{bits}: {found:?} {truth}"
            );
            assert!(found.samples < 2 * truth, "{bits}: {found:?} {truth}");
        }
        // The ADC locked to the bridge, and scopes whose rate is a multiple of it.
        for per_period in [61.0 / 3.0, 24.5, 1000.0] {
            let wave = |k: u32| (TAU * f64::from(k) / per_period).cos() as f32;
            let repeated: Vec<f32> = (0..100_000).map(wave).collect();
            assert_eq!(count_clipped(&repeated, None).samples, 0, "{per_period}");
        }
    }

    #[test]
    fn noise_that_reaches_the_ends_is_none_and_a_clipped_crest_in_noise_is() {
        let noisy = |rail: f64| {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let wave = |k: u32| (TAU * f64::from(k) / 40.3).sin();
            let noise = move |_| -> f64 { 0.22 * rng.sample::<f64, _>(StandardNormal) };
            let x = (0..200_000).map(wave).zip((0..).map(noise));
            let x: Vec<f32> = x.map(|(x, n)| (x + n).clamp(-rail, rail) as f32).collect();
            let clipped = count_clipped(&x, Some(rail));
            assert!(clipped.samples > 100, "{rail}: {clipped:?}");
            clipped.are_tails_of_noise(&x, 10.0, 40.3)
        };
        assert!(noisy(1.5));
        for rail in [1.2, 1.0, 0.8] {
            assert!(!noisy(rail), "{rail}");
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
        x[700] = 0.0;
        let upper = count_clipped(&x, Some(1.0));
        assert_eq!(
            (upper.samples, upper.rails.low, upper.rails.high),
            (2, None, Some(1.0))
        );
    }
}
