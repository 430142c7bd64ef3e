//! Segment: evenly sampled coil voltage and current, the input of every estimator.

use std::f64::consts::TAU;

use crate::vectorised::{self, dot, vectorised};
use crate::{RawSamples, Samples};

/// Fewest switching periods that an estimator can work on.
pub const MIN_PERIODS: f64 = 10.0;

/// Fewest samples per switching period; below, the fundamental is beyond half the sampling rate.
const MIN_SAMPLES_PER_PERIOD: f64 = 2.0;

/// Largest magnitude of a time in seconds: beyond, adjacent samples would have equal times in rounding.
const LATEST_S: f64 = 1e6;

/// Part of a capture with one switching frequency, evenly sampled, without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Mains frequency in hertz.
    pub mains_hz: f64,
    /// Time of one mains zero crossing in seconds, on the capture's clock; it may lie outside.
    pub zero_crossing_s: f64,
    /// Time of the first sample in seconds, on the capture's clock.
    pub t0_s: f64,
    /// Time from one sample to the next in seconds.
    pub dt_s: f64,
    /// Coil voltage in volt.
    pub v_v: Samples,
    /// Coil current in ampere, at the same instants.
    pub i_a: Samples,
}

impl Segment {
    /// Number of samples of each channel.
    pub fn len(&self) -> usize {
        self.v_v.len()
    }

    /// Returns `true` if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.v_v.is_empty()
    }

    /// Time of sample `k` in seconds, on the capture's clock.
    pub fn t_s(&self, k: usize) -> f64 {
        self.t0_s + k as f64 * self.dt_s
    }

    /// Sample at a time in seconds on the capture's clock: the nearest, the first for all times before.
    pub fn index_at(&self, t_s: f64) -> usize {
        ((t_s - self.t0_s) / self.dt_s).round().max(0.0) as usize
    }

    /// Number of switching periods, seldom a whole one.
    pub fn periods(&self) -> f64 {
        self.len() as f64 / self.samples_per_period()
    }

    /// Returns the error of a segment of which so many switching periods are needed.
    pub fn too_short(&self, needed: f64) -> SegmentError {
        SegmentError::TooShort {
            periods: self.periods(),
            needed,
        }
    }

    /// Samples of one switching period, seldom a whole number.
    pub fn samples_per_period(&self) -> f64 {
        1.0 / (self.f_sw_hz * self.dt_s)
    }

    /// Duration of a mains half-cycle in seconds.
    pub fn half_cycle_s(&self) -> f64 {
        0.5 / self.mains_hz
    }

    /// Time after the last mains zero crossing in seconds, 0 to [`Segment::half_cycle_s`].
    pub fn since_crossing_s(&self, t_s: f64) -> f64 {
        (t_s - self.zero_crossing_s).rem_euclid(self.half_cycle_s())
    }

    /// Time in seconds, on the capture's clock, of the mains zero crossing at which the half-cycle of samples `from` up to `to`
    /// begins. The middle of the range decides, because its first sample may lie just before the crossing.
    pub fn crossing_of_s(&self, (from, to): (usize, usize)) -> f64 {
        let middle_s = 0.5 * (self.t_s(from) + self.t_s(to - 1));
        middle_s - self.since_crossing_s(middle_s)
    }

    /// Ranges of samples between mains zero crossings, the ends of the segment included.
    pub fn half_cycles(&self) -> Vec<(usize, usize)> {
        let half_s = self.half_cycle_s();
        let first = ((self.t0_s - self.zero_crossing_s) / half_s).floor() + 1.0;
        let mut bounds = vec![0];
        let mut crossing_s = self.zero_crossing_s + first * half_s;
        // A crossing within half a sample of either end cuts nothing off.
        while crossing_s < self.t_s(self.len()) - 0.5 * self.dt_s {
            let at = ((crossing_s - self.t0_s) / self.dt_s).round() as usize;
            if at > 0 {
                bounds.push(at);
            }
            crossing_s += half_s;
        }
        bounds.push(self.len());
        bounds.windows(2).map(|w| (w[0], w[1])).collect()
    }

    /// Checks the conditions of all estimators.
    ///
    /// # Errors
    /// [`SegmentError`]: channels of different length, a number that is not finite, times or
    /// frequencies that are not positive, too few samples per period, too few periods, a silent
    /// channel.
    pub fn check(&self) -> Result<(), SegmentError> {
        if self.v_v.len() != self.i_a.len() {
            return Err(SegmentError::Lengths {
                v: self.v_v.len(),
                i: self.i_a.len(),
            });
        }
        for (what, value) in [
            ("switching frequency in Hz", self.f_sw_hz),
            ("mains frequency in Hz", self.mains_hz),
            ("sampling interval in s", self.dt_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(SegmentError::NotPositive { what, value });
            }
        }
        for (what, value) in [
            ("time of the first sample in s", self.t0_s),
            ("time of the mains zero crossing in s", self.zero_crossing_s),
        ] {
            if value.is_nan() || value.abs() > LATEST_S {
                let allowed = "within ±1e6 s: count time from the capture's start";
                return Err(SegmentError::OutOfRange {
                    what,
                    value,
                    allowed,
                });
            }
        }
        if self.mains_hz * MIN_PERIODS > self.f_sw_hz {
            return Err(SegmentError::OutOfRange {
                what: "mains frequency in Hz",
                value: self.mains_hz,
                allowed: "at most a tenth of the switching frequency",
            });
        }
        let per_period = self.samples_per_period();
        if per_period.is_nan() || per_period <= MIN_SAMPLES_PER_PERIOD {
            return Err(SegmentError::SamplingTooSlow {
                rate_hz: 1.0 / self.dt_s,
                f_sw_hz: self.f_sw_hz,
            });
        }
        if self.periods() < MIN_PERIODS {
            return Err(self.too_short(MIN_PERIODS));
        }
        check_channel("voltage", &self.v_v)?;
        check_channel("current", &self.i_a)
    }

    /// Returns the segment without its channels' means. Neither the coil's voltage nor its current has a mean, so that it is the
    /// measuring chain's offset. The weighting excludes the carrier, for any number of its periods.
    pub fn without_offsets(&self) -> Self {
        let less_mean = |x: &Samples| x.less(weighted_mean(x));
        self.with_channels(less_mean(&self.v_v), less_mean(&self.i_a))
    }

    /// Returns the segment with other samples.
    pub fn with_samples(&self, v_v: Vec<f64>, i_a: Vec<f64>) -> Self {
        self.with_channels(v_v.into(), i_a.into())
    }

    fn with_channels(&self, v_v: Samples, i_a: Samples) -> Self {
        Self {
            f_sw_hz: self.f_sw_hz,
            mains_hz: self.mains_hz,
            zero_crossing_s: self.zero_crossing_s,
            t0_s: self.t0_s,
            dt_s: self.dt_s,
            v_v,
            i_a,
        }
    }

    /// Returns the samples from index `from` up to `to`, clamped to the existing ones.
    pub fn part(&self, from: usize, to: usize) -> Self {
        let to = to.min(self.len());
        let from = from.min(to);
        Self {
            t0_s: self.t_s(from),
            ..self.with_channels(self.v_v.part(from..to), self.i_a.part(from..to))
        }
    }
}

/// Reason why a segment cannot be used by estimators.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentError {
    /// Voltage and current differ in length.
    #[error("{v} voltage samples but {i} current samples: pass both channels of one capture")]
    Lengths {
        /// Number of voltage samples.
        v: usize,
        /// Number of current samples.
        i: usize,
    },
    /// A time or frequency is not positive.
    #[error("the {what} is {value}, but must be a finite number above zero")]
    NotPositive {
        /// Name of the quantity.
        what: &'static str,
        /// Value of the quantity.
        value: f64,
    },
    /// A quantity is outside the range of hobs.
    #[error("the {what} is {value}, but must be {allowed}")]
    OutOfRange {
        /// Name of the quantity.
        what: &'static str,
        /// Value of the quantity.
        value: f64,
        /// Allowed range.
        allowed: &'static str,
    },
    /// A sample is not finite, or too large.
    #[error("{channel} sample {index} is {value}: cut it out or repair the capture")]
    NotFinite {
        /// `voltage` or `current`.
        channel: &'static str,
        /// Index in the segment.
        index: usize,
        /// Value of the sample.
        value: f64,
    },
    /// A channel is zero throughout.
    #[error("the {channel} is zero throughout: is the inverter running and the probe on?")]
    Silent {
        /// `voltage` or `current`.
        channel: &'static str,
    },
    /// Fewer than two samples per switching period.
    #[error(
        "sampled at {rate_hz:.0} Hz, which cannot show a switching frequency of {f_sw_hz:.0} Hz: \
         sample at more than twice of it"
    )]
    SamplingTooSlow {
        /// Sampling rate in hertz.
        rate_hz: f64,
        /// Switching frequency in hertz.
        f_sw_hz: f64,
    },
    /// Too few switching periods.
    #[error("{periods:.1} switching periods, but {needed:.0} are needed: take a longer capture")]
    TooShort {
        /// Switching periods in the segment.
        periods: f64,
        /// Switching periods needed.
        needed: f64,
    },
}

/// Largest magnitude of a sample, in volt or ampere, whose powers are still finite numbers.
const MAX_SAMPLE: f64 = 1e30;

fn check_channel(channel: &'static str, x: &Samples) -> Result<(), SegmentError> {
    match x.raw() {
        RawSamples::Doubles(x) => check_values(channel, x, 0.0),
        RawSamples::Singles(x, offset) => check_values(channel, x, offset),
    }
}

fn check_values<T: Copy + Into<f64>>(
    channel: &'static str,
    x: &[T],
    offset: f64,
) -> Result<(), SegmentError> {
    let value = |x: T| x.into() - offset;
    let mut loud = false;
    for (block, x) in x.chunks(BLOCK).enumerate() {
        // The comparison is false for NaN.
        let sound = vectorised(
            #[inline(always)]
            || (x.iter()).fold(true, |sound, x| sound & (value(*x).abs() <= MAX_SAMPLE)),
        );
        if !sound {
            let bad = |x: &T| value(*x).is_nan() || value(*x).abs() > MAX_SAMPLE;
            let index = x.iter().position(bad).unwrap_or(0);
            return Err(SegmentError::NotFinite {
                channel,
                index: block * BLOCK + index,
                value: value(x[index]),
            });
        }
        loud = loud || x.iter().any(|x| value(*x).abs() >= 1.0 / MAX_SAMPLE);
    }
    if loud {
        Ok(())
    } else {
        Err(SegmentError::Silent { channel })
    }
}

/// Samples that are read at a time.
const BLOCK: usize = 4096;

/// Mean under a Hann window over all samples.
fn weighted_mean(x: &Samples) -> f64 {
    match x.raw() {
        RawSamples::Doubles(x) => hann_mean(x, 0.0),
        RawSamples::Singles(x, offset) => hann_mean(x, offset),
    }
}

/// Mean under the weights of [`hann`](crate::fourier::hann), which need not be stored.
fn hann_mean<T: Copy + Into<f64>>(x: &[T], offset: f64) -> f64 {
    // Samples of the tables, and from one sine and cosine to the next.
    const TABLE: usize = 512;
    let turns = |k: f64| TAU * (k + 0.5) / x.len().max(1) as f64;
    // The angles of a block's samples are the angle of its first one plus those of a table.
    let table = |of: fn(f64) -> f64| -> Vec<f64> {
        (0..TABLE)
            .map(|k| of(turns(k as f64) - turns(0.0)))
            .collect()
    };
    let (cos, sin) = (table(libm::cos), table(libm::sin));
    let (mut less, mut weights) = ([0.0; TABLE], [0.0; TABLE]);
    let (mut sum, mut all) = (0.0, 0.0);
    for (block, x) in x.chunks(TABLE).enumerate() {
        let (s, c) = libm::sincos(turns((block * TABLE) as f64));
        let [weighted, weight] = vectorised(
            #[inline(always)]
            || {
                let (less, weights) = (&mut less[..x.len()], &mut weights[..x.len()]);
                for (y, x) in less.iter_mut().zip(x) {
                    *y = (*x).into() - offset;
                }
                for (y, (cos, sin)) in weights.iter_mut().zip(cos.iter().zip(&sin)) {
                    *y = 1.0 - (c * cos - s * sin);
                }
                [dot(weights, less), vectorised::sum(weights)]
            },
        );
        sum += weighted;
        all += weight;
    }
    if all > 0.0 { sum / all } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_taken_off_and_the_carrier_stays() {
        // Not a whole number of periods.
        let n = 12_345;
        let wave = |k: usize, a: f64| {
            let t_s = k as f64 * 80e-9;
            a * libm::sin(TAU * 50.0 * t_s) * libm::sin(TAU * 45e3 * t_s + 0.4)
        };
        let segment = |v_offset_v: f64, i_offset_a: f64| Segment {
            f_sw_hz: 45e3,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s: 80e-9,
            v_v: (0..n).map(|k| wave(k, 290.0) + v_offset_v).collect(),
            i_a: (0..n).map(|k| wave(k, 42.0) + i_offset_a).collect(),
        };
        let (clean, off) = (segment(0.0, 0.0), segment(12.0, -3.0).without_offsets());
        for (a, b) in clean.v_v.iter().zip(&off.v_v) {
            assert!((a - b).abs() < 3e-3, "{a} {b}");
        }
        for (a, b) in clean.i_a.iter().zip(&off.i_a) {
            assert!((a - b).abs() < 5e-4, "{a} {b}");
        }
        // The blocks' angles add up to those of the window itself.
        let weights = crate::fourier::hann(n);
        let x = clean.v_v.iter().zip(&weights);
        let mean = x.map(|(x, w)| x * w).sum::<f64>() / weights.iter().sum::<f64>();
        assert!((weighted_mean(&clean.v_v) - mean).abs() < 1e-9);
        let empty = clean.with_samples(Vec::new(), Vec::new());
        assert!(empty.without_offsets().is_empty());
    }
}
