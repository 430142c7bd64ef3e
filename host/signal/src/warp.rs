//! Time warping of samples to a constant carrier frequency.

use std::ops::Range;

use crate::Segment;
use crate::carrier::Carrier;

/// Samples per period from which four neighbours are enough for interpolation. The fundamental then has an error of 4e-7 at
/// 100 samples per period with four, and of 1e-7 at 20 with eight.
const FINE_SAMPLES_PER_PERIOD: f64 = 100.0;

/// Part of a segment with a time in which the carrier's frequency is constant, its mean there. Both ends of the part keep
/// their times.
#[derive(Clone, Debug)]
pub struct Warp<'a> {
    segment: &'a Segment,
    carrier: &'a Carrier,
    /// Index of the part's first sample in the segment.
    first: usize,
    /// Samples of the part.
    len: usize,
    /// Constant frequency in hertz.
    f_hz: f64,
    /// Periods of the carrier at the first sample.
    periods_at_first: f64,
}

impl<'a> Warp<'a> {
    /// Creates the warp of a range of the segment's samples, which must not be empty.
    pub fn new(segment: &'a Segment, carrier: &'a Carrier, range: Range<usize>) -> Self {
        let (from_s, to_s) = (segment.t_s(range.start), segment.t_s(range.end));
        let periods_at_first = carrier.periods(from_s);
        Self {
            segment,
            carrier,
            first: range.start,
            len: range.len(),
            f_hz: (carrier.periods(to_s) - periods_at_first) / (to_s - from_s),
            periods_at_first,
        }
    }

    /// Time in seconds of the part's first sample, which both clocks share.
    fn start_s(&self) -> f64 {
        self.segment.t_s(self.first)
    }

    /// Samples at constant frequency, as many as the part has.
    pub fn samples(&self) -> Segment {
        let mut search = Search::new(self.carrier);
        let dt_s = self.segment.dt_s;
        let places = (0..self.len).map(|k| {
            let periods = self.periods_at_first + self.f_hz * k as f64 * dt_s;
            (search.time_s(periods) - self.segment.t0_s) / dt_s
        });
        let places: Vec<f64> = places.collect();
        let fine = self.segment.samples_per_period() > FINE_SAMPLES_PER_PERIOD;
        Segment {
            f_sw_hz: self.f_hz,
            t0_s: self.start_s(),
            ..self.segment.with_samples(
                interpolated(&self.segment.v_v, &places, fine),
                interpolated(&self.segment.i_a, &places, fine),
            )
        }
    }

    /// Time of the capture in seconds at a warped time.
    pub fn time_s(&self, warped_s: f64) -> f64 {
        let periods = self.periods_at_first + self.f_hz * (warped_s - self.start_s());
        Search::new(self.carrier).time_s(periods)
    }

    /// Carrier frequency at a time of the capture over that of the warped samples; divides the L found in warped time.
    pub fn rate(&self, t_s: f64) -> f64 {
        self.carrier.hz(t_s) / self.f_hz
    }

    /// Resamples a waveform from the warped times to those of the part's samples.
    pub fn unwarped(&self, x: &[f32]) -> Vec<f32> {
        let x: Vec<f64> = x.iter().map(|x| f64::from(*x)).collect();
        let dt_s = self.segment.dt_s;
        let place = |k: usize| {
            let periods = self.carrier.periods(self.segment.t_s(self.first + k));
            (periods - self.periods_at_first) / (self.f_hz * dt_s)
        };
        let places: Vec<f64> = (0..self.len).map(place).collect();
        let fine = self.segment.samples_per_period() > FINE_SAMPLES_PER_PERIOD;
        let out = interpolated(&x, &places, fine);
        out.into_iter().map(|x| x as f32).collect()
    }
}

/// Search for the times of ascending counts of periods.
struct Search<'a> {
    carrier: &'a Carrier,
    /// Index of the present value.
    at: usize,
}

impl<'a> Search<'a> {
    fn new(carrier: &'a Carrier) -> Self {
        let at = 0;
        Self { carrier, at }
    }

    /// Time in seconds at which so many periods have passed since the carrier's first value.
    fn time_s(&mut self, periods: f64) -> f64 {
        let Carrier {
            t0_s,
            step_s,
            f_hz,
            periods: all,
            ..
        } = self.carrier;
        let last = f_hz.len() - 1;
        while self.at + 1 < last && all[self.at + 1] <= periods {
            self.at += 1;
        }
        let k = self.at;
        let left = periods - all[k];
        let (a, b) = (f_hz[k], f_hz[k + 1]);
        let within_s = if left < 0.0 {
            left / a
        } else if periods > all[last] {
            step_s + (periods - all[last]) / b
        } else {
            // left = a·s + (b − a)/step·s²/2, without the difference of two close numbers.
            2.0 * left / (a + (a * a + 2.0 * (b - a) / step_s * left).max(0.0).sqrt())
        };
        t0_s + k as f64 * step_s + within_s
    }
}

/// Interpolates a waveform between its samples by Lagrange's polynomial through the nearest 4 or 8. The outermost
/// polynomial is used beyond the ends.
fn interpolated(x: &[f64], places: &[f64], fine: bool) -> Vec<f64> {
    if fine {
        lagrange::<4>(x, places)
    } else {
        lagrange::<8>(x, places)
    }
}

fn lagrange<const N: usize>(x: &[f64], places: &[f64]) -> Vec<f64> {
    if x.len() < N {
        return vec![x.first().copied().unwrap_or(0.0); places.len()];
    }
    // 1/Π (j − k), the same for every place.
    let scale: [f64; N] = std::array::from_fn(|j| {
        let others = (0..N).filter(|k| *k != j);
        1.0 / others.map(|k| j as f64 - k as f64).product::<f64>()
    });
    let last = x.len() - N;
    places
        .iter()
        .map(|place| {
            let first = (place - (N / 2 - 1) as f64).floor().max(0.0) as usize;
            let first = first.min(last);
            let at: [f64; N] = std::array::from_fn(|k| place - first as f64 - k as f64);
            let (mut left, mut right) = ([1.0; N], [1.0; N]);
            for k in 1..N {
                left[k] = left[k - 1] * at[k - 1];
                right[N - 1 - k] = right[N - k] * at[N - k];
            }
            let near = &x[first..first + N];
            (0..N)
                .map(|k| near[k] * scale[k] * left[k] * right[k])
                .sum()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn interpolation_keeps_the_fundamental_to_1e_5() {
        for (per_period, fine) in [(20.0, false), (61.0 / 3.0, false), (1000.0, true)] {
            let wave = |at: f64| libm::cos(TAU * at / per_period + 0.3);
            let x: Vec<f64> = (0..4000).map(|k| wave(f64::from(k))).collect();
            let places: Vec<f64> = (0..3000).map(|k| 10.0 + 1.07 * f64::from(k)).collect();
            for (found, at) in interpolated(&x, &places, fine).iter().zip(&places) {
                assert!((found - wave(*at)).abs() < 1e-6, "{per_period} {at}");
            }
        }
    }
}
