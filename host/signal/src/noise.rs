//! White noise of a channel, measured as the floor of its spectrum between the lines. Survey and estimators share it.
//!
//! Between the harmonics of f_sw there is noise, but also edges that the sampling folds there, or a neighbour's coil. Many
//! places are therefore measured, up to the eighth harmonic, where the estimators work, and the quiet ones are used. The
//! result is a low quantile over the places of the median over the frames, because zero crossings and steps of the load are
//! single frames. Both are known functions of σ for white noise, so that the result is unbiased for it.

use std::f64::consts::PI;

use nalgebra::Complex;

use super::vectorised::{dot, vectorised};
use super::{RawSamples, Samples, Segment, fourier};

/// Most switching periods of a frame: three eighths of the lobes of sin⁶ between aliases at thirds of f_sw (61/3).
const MAX_PERIODS: f64 = 96.0;

/// Fewest switching periods of a frame, used for short segments.
const MIN_PERIODS: f64 = 12.0;

/// Number of frames into which short segments are divided.
const WANTED_FRAMES: f64 = 6.0;

/// Most frames that are evaluated.
const MAX_FRAMES: usize = 32;

/// Fewest samples per period after decimation by a low-pass.
const KEPT_PER_PERIOD: f64 = 64.0;

/// Highest order of f_sw that is evaluated.
const MAX_ORDER: f64 = 8.75;

/// Bins on either side of a harmonic that its lobe (4 bins) and its modulation occupy.
const LINE_BINS: f64 = 6.5;

/// Largest distance in orders that a harmonic occupies on either side.
const LINE_MOST: f64 = 0.36;

/// Quantile over the places: lines may occupy most of the rest.
const QUANTILE: f64 = 0.2;

/// Mean of the squares of samples; 0 without one.
pub fn mean_square(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64
}

/// Root of the [mean square](mean_square).
pub fn rms(x: &[f64]) -> f64 {
    mean_square(x).sqrt()
}

/// Standard deviation of one sample's white noise; zero if it could not be measured.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct WhiteNoise {
    /// Standard deviation of the voltage in volt.
    pub v_v: f64,
    /// Standard deviation of the current in ampere.
    pub i_a: f64,
}

impl WhiteNoise {
    /// Measures the noise of a segment; zero if it is shorter than 12 switching periods.
    pub fn measure(segment: &Segment) -> Self {
        let Some(floor) = SpectralFloor::new(segment.len(), segment.samples_per_period()) else {
            return Self::default();
        };
        // An offset is not noise.
        let of = |x: &Samples| match x.raw() {
            RawSamples::Doubles(x) => floor.deviation(x).unwrap_or(0.0),
            RawSamples::Singles(x, _) => floor.deviation(x).unwrap_or(0.0),
        };
        Self {
            v_v: of(&segment.v_v),
            i_a: of(&segment.i_a),
        }
    }

    /// Returns this noise, with the other one for a channel on which it could not be measured.
    pub fn or_else(self, other: impl FnOnce() -> Self) -> Self {
        if self.v_v > 0.0 && self.i_a > 0.0 {
            return self;
        }
        let other = other();
        let measured = |own: f64, other: f64| if own > 0.0 { own } else { other };
        Self {
            v_v: measured(self.v_v, other.v_v),
            i_a: measured(self.i_a, other.i_a),
        }
    }

    /// Deviations in volt and ampere; `None` if the segment was too short.
    pub fn measured(self) -> Option<[f64; 2]> {
        (self != Self::default()).then_some([self.v_v, self.i_a])
    }
}

/// Standard deviation of a channel's white noise near the first harmonics, in its unit; `None` if the samples are
/// too few.
pub fn deviation<T: Copy + Into<f64>>(x: &[T], samples_per_period: f64) -> Option<f64> {
    SpectralFloor::new(x.len(), samples_per_period)?.deviation(x)
}

/// Measurement of the floor between the harmonics, for channels of one length.
struct SpectralFloor {
    frames: Frames,
    places: Vec<usize>,
    window: Vec<f64>,
    low_pass: Vec<f64>,
}

impl SpectralFloor {
    /// `None` if the samples are too few.
    fn new(samples: usize, samples_per_period: f64) -> Option<Self> {
        let frames = Frames::new(samples, samples_per_period)?;
        let places = frames.places();
        (!places.is_empty()).then(|| Self {
            window: sin6(frames.points),
            low_pass: low_pass(frames.block),
            places,
            frames,
        })
    }

    fn deviation<T: Copy + Into<f64>>(&self, x: &[T]) -> Option<f64> {
        let (frames, places) = (&self.frames, &self.places);
        // One row per place, one column per frame.
        let mut powers = vec![0.0; places.len() * frames.count];
        let fft = fourier::forward(frames.points);
        let (mut input, mut output) = (fft.make_input_vec(), fft.make_output_vec());
        for frame in 0..frames.count {
            self.weigh(&x[frame * frames.stride..], &mut input);
            fft.process(&mut input, &mut output).ok()?;
            for (row, place) in powers.chunks_exact_mut(frames.count).zip(places) {
                row[frame] = output[*place].norm_sqr();
            }
        }
        // |X|² of white noise is exponential with mean σ²·Σw², times the low-pass gain there, over the decimation factor.
        let mean = self.window.iter().map(|w| w * w).sum::<f64>() / frames.block as f64;
        let floor = |(row, place): (&mut [f64], &usize)| {
            let turn = *place as f64 / (frames.points * frames.block) as f64;
            Some(median(row)? / (mean * gain(&self.low_pass, turn)))
        };
        let rows = powers.chunks_exact_mut(frames.count);
        let mut floors: Vec<f64> = rows.zip(places).filter_map(floor).collect();
        let at = (QUANTILE * floors.len() as f64) as usize;
        let quiet = *floors.select_nth_unstable_by(at, f64::total_cmp).1;
        let share = (at as f64 + 0.6) / (floors.len() as f64 + 0.2);
        Some((quiet / quantile_of_median(frames.count, share)).sqrt()).filter(|s| s.is_finite())
    }

    /// Decimated samples from the first on, times the window.
    fn weigh<T: Copy + Into<f64>>(&self, x: &[T], weighted: &mut [f64]) {
        let weighted = weighted.iter_mut().zip(&self.window);
        if self.frames.block == 1 {
            for ((y, w), x) in weighted.zip(x) {
                *y = w * (*x).into();
            }
            return;
        }
        let mut weighted = weighted.zip(x.windows(self.low_pass.len()).step_by(self.frames.block));
        vectorised(
            #[inline(always)]
            || {
                for ((y, w), x) in weighted.by_ref() {
                    *y = w * dot(&self.low_pass, x);
                }
            },
        );
    }
}

/// Hann low-pass over four times the decimation factor: edges that fold to below the eighth harmonic are reduced to less
/// than a thousandth.
fn low_pass(block: usize) -> Vec<f64> {
    if block == 1 {
        return vec![1.0];
    }
    fourier::hann(4 * block)
}

/// |Σ h·e^(−j2πfn)|² at f = `turn` periods per sample.
fn gain(h: &[f64], turn: f64) -> f64 {
    if let [only] = h {
        return only * only;
    }
    let step = Complex::from_polar(1.0, -2.0 * PI * turn);
    let mut at = Complex::new(1.0, 0.0);
    let mut sum = Complex::new(0.0, 0.0);
    for h in h {
        sum += at * *h;
        at *= step;
    }
    sum.norm_sqr()
}

/// Division of samples into frames.
struct Frames {
    /// Decimation factor.
    block: usize,
    /// Decimated points per frame.
    points: usize,
    /// Samples from one frame to the next.
    stride: usize,
    count: usize,
    /// Orders of f_sw from one bin to the next.
    order_per_bin: f64,
    /// Decimated points per switching period.
    per_period: f64,
}

impl Frames {
    fn new(samples: usize, samples_per_period: f64) -> Option<Self> {
        let periods = samples as f64 / samples_per_period;
        if !(periods.is_finite() && samples_per_period > 2.0) {
            return None;
        }
        let block = ((samples_per_period / KEPT_PER_PERIOD) as usize).max(1);
        let per_period = samples_per_period / block as f64;
        let ideal = (periods / WANTED_FRAMES).clamp(MIN_PERIODS + 1.0, MAX_PERIODS) * per_period;
        // A transform over a multiple of 16 points is fast.
        let points = ((ideal / 16.0).ceil() as usize * 16).min((samples / block).saturating_sub(3));
        if (points as f64) < MIN_PERIODS * per_period {
            return None;
        }
        // The low-pass reaches three blocks beyond the last.
        let frame = block * (points + 3);
        let count = (samples / frame).min(MAX_FRAMES);
        Some(Self {
            block,
            points,
            stride: (samples - frame) / count.saturating_sub(1).max(1),
            count,
            order_per_bin: per_period / points as f64,
            per_period,
        })
    }

    /// Bins between the harmonics, away from them.
    fn places(&self) -> Vec<usize> {
        let highest = MAX_ORDER.min(0.5 * self.per_period - 0.2);
        let taken = (LINE_BINS * self.order_per_bin).min(LINE_MOST);
        let away = |order: f64| (order - order.round()).abs() >= taken;
        let order = |bin: &usize| *bin as f64 * self.order_per_bin;
        (1..self.points / 2)
            .take_while(|bin| order(bin) <= highest)
            .filter(|bin| away(order(bin)))
            .collect()
    }
}

/// sin⁶: its lobe is 4 bins wide, and 8 bins away it is below 1e-6.
fn sin6(n: usize) -> Vec<f64> {
    let at = |k: usize| {
        let sine = libm::sin(PI * (k as f64 + 0.5) / n as f64);
        let square = sine * sine;
        square * square * square
    };
    let half: Vec<f64> = (0..n.div_ceil(2)).map(at).collect();
    (0..n).map(|k| half[k.min(n - 1 - k)]).collect()
}

/// Median of values, which are reordered; of an even number the lower one. `None` if there are none.
pub fn median(x: &mut [f64]) -> Option<f64> {
    let middle = x.len().saturating_sub(1) / 2;
    (!x.is_empty()).then(|| *x.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Value below which [`median`] of `count` exponential numbers of mean 1 stays with this probability.
fn quantile_of_median(count: usize, probability: f64) -> f64 {
    // The median is below x if (count + 1)/2 of them are.
    let needed = count.div_ceil(2);
    let below = |x: f64| {
        let one = -libm::expm1(-x);
        let mut term = libm::pow(1.0 - one, count as f64);
        let mut sum = 0.0;
        for k in 0..=count {
            if k >= needed {
                sum += term;
            }
            term *= (count - k) as f64 / (k + 1) as f64 * one / (1.0 - one);
        }
        sum
    };
    let (mut low, mut high) = (1e-9, 10.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if below(middle) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_the_median_are_those_of_the_exponential_and_of_known_order_statistics() {
        // One number: the exponential itself. Three: F²(3 − 2F) = 1/2 at F = 1/2, x = ln 2.
        let of_one = -(1.0_f64 - 0.2).ln();
        assert!((quantile_of_median(1, 0.2) - of_one).abs() < 1e-9);
        assert!((quantile_of_median(3, 0.5) - std::f64::consts::LN_2).abs() < 1e-9);
        // Many: all quantiles close in on ln 2.
        assert!((quantile_of_median(32, 0.2) / 0.577 - 1.0).abs() < 0.1);
    }

    #[test]
    fn another_noise_stands_for_what_was_not_measured() {
        let noise = |v_v, i_a| WhiteNoise { v_v, i_a };
        let whole = || noise(2.0, 0.3);
        assert_eq!(noise(1.0, 0.1).or_else(whole), noise(1.0, 0.1));
        assert_eq!(noise(1.0, 0.0).or_else(whole), noise(1.0, 0.3));
        assert_eq!(WhiteNoise::default().or_else(whole), whole());
    }

    #[test]
    fn what_is_too_short_gives_nothing() {
        assert_eq!(deviation(&[1.0f32; 500], 50.0), None);
        assert_eq!(deviation::<f64>(&[], 50.0), None);
        assert_eq!(deviation(&[1.0f32; 5000], f64::NAN), None);
        assert_eq!(deviation(&[0.0f32; 5000], 50.0), Some(0.0));
    }
}
