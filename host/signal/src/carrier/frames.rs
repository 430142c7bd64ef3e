//! Fundamental of voltage and current in frames of two switching periods.

use std::f64::consts::TAU;

use nalgebra::Complex;

use crate::correlation::weighted_sums;
use crate::fourier::hann;
use crate::{RawSamples, Segment};

/// Switching periods per frame, under a Hann window, whose gain is zero at the mean and at the harmonics.
const FRAME_PERIODS: f64 = 2.0;

/// Fundamental in frames of two switching periods, one a period: sums of samples times Hann's window and e^(−jωt), whose angle counts
/// from the frame's first sample.
#[derive(Clone, Debug)]
pub struct HannFrames {
    /// Sums of the voltage in volt.
    pub v: Vec<Complex<f64>>,
    /// Sums of the current in ampere.
    pub i: Vec<Complex<f64>>,
    /// Samples of a frame.
    pub length: usize,
    /// Samples from one frame to the next.
    pub hop: usize,
    /// Time of the first sample in seconds.
    pub(super) t0_s: f64,
    /// Time from one sample to the next in seconds.
    pub(super) dt_s: f64,
    /// Expected frequency in hertz.
    pub(super) f_hz: f64,
}

impl HannFrames {
    /// Computes the frames of a segment; `None` if it has no more than two samples a period.
    pub fn compute(segment: &Segment) -> Option<Self> {
        let sampling = (segment.t0_s, segment.dt_s, segment.f_sw_hz);
        // A constant offset hardly passes the frames.
        match (segment.v_v.raw(), segment.i_a.raw()) {
            (RawSamples::Singles(v, v_v), RawSamples::Singles(i, i_a)) => {
                let mut frames = Self::of_samples([v, i], sampling)?;
                frames.subtract([v_v, i_a]);
                Some(frames)
            }
            _ => Self::of_samples([&segment.v_v, &segment.i_a], sampling),
        }
    }

    /// Computes the frames of voltage and current, the first sample at `t0_s` seconds.
    pub(super) fn of_samples<T: Copy + Into<f64>>(
        [v_v, i_a]: [&[T]; 2],
        (t0_s, dt_s, f_hz): (f64, f64, f64),
    ) -> Option<Self> {
        let per_period = 1.0 / (f_hz * dt_s);
        if !(per_period.is_finite() && per_period > 2.0) {
            return None;
        }
        let length = (FRAME_PERIODS * per_period).round() as usize;
        let hop = (per_period.round() as usize).max(1);
        let weights = weights(length, f_hz * dt_s);
        let of = |x: &[T]| {
            let frames = x.windows(length).step_by(hop);
            let sums = frames.map(|x| weighted_sums(x, [&weights[0], &weights[1]]));
            sums.map(|[re, im]| Complex::new(re, im)).collect()
        };
        Some(Self {
            v: of(v_v),
            i: of(i_a),
            length,
            hop,
            t0_s,
            dt_s,
            f_hz,
        })
    }

    /// Subtracts constant offsets of voltage and current from the samples.
    fn subtract(&mut self, offsets: [f64; 2]) {
        if offsets == [0.0; 2] {
            return;
        }
        let [re, im] = weights(self.length, self.f_hz * self.dt_s);
        let of_one = Complex::new(re.iter().sum(), im.iter().sum());
        for (sums, offset) in [&mut self.v, &mut self.i].into_iter().zip(offsets) {
            sums.iter_mut().for_each(|sum| *sum -= of_one * offset);
        }
    }

    /// Time from one frame to the next in seconds.
    pub fn step_s(&self) -> f64 {
        self.hop as f64 * self.dt_s
    }

    /// Rotation of the fundamental from each frame to the next, beyond the expected one: a phasor from both channels, whose
    /// magnitude is its weight by power.
    pub(super) fn turns(&self) -> Vec<Complex<f64>> {
        let expected = Complex::from_polar(1.0, -turn(self.hop, self.f_hz * self.dt_s));
        let mut sum = vec![Complex::new(0.0, 0.0); self.v.len().saturating_sub(1)];
        for phasors in [&self.v, &self.i] {
            let power: f64 = phasors.iter().map(Complex::norm_sqr).sum();
            let scale = if power > 0.0 { 1.0 / power } else { 0.0 };
            for (sum, w) in sum.iter_mut().zip(phasors.windows(2)) {
                *sum += w[1] * w[0].conj() * expected * scale;
            }
        }
        sum
    }
}

/// Angle of the carrier at sample `k` in radian.
fn turn(k: usize, periods_per_sample: f64) -> f64 {
    TAU * (k as f64 * periods_per_sample).fract()
}

/// Hann's window times the real and the imaginary part of e^(−jωt).
fn weights(length: usize, periods_per_sample: f64) -> [Vec<f64>; 2] {
    let hann = hann(length);
    let of = |part: fn(f64) -> f64| {
        let weights = hann.iter().enumerate();
        let turned = weights.map(|(k, w)| w * part(turn(k, periods_per_sample)));
        turned.collect()
    };
    [of(libm::cos), of(|angle| -libm::sin(angle))]
}
