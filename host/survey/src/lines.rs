//! Strongest line of every frame of a short-time spectrum of voltage and current.

use std::ops::Range;
use std::sync::Arc;

use ihd_signal::Capture;
use ihd_signal::fourier::{self, RealToComplex};
use ihd_signal::noise::mean_square;
use ihd_signal::vectorised::{sum, vectorised};
use nalgebra::Complex;

use super::time::Run;

/// Smallest switching frequency of the search, in hertz.
pub const MIN_HZ: f64 = 15e3;

/// Largest switching frequency of the search, in hertz.
pub const MAX_HZ: f64 = 150e3;

/// Sampling rate in hertz to which samples are averaged for the search: four times the largest frequency.
const SEARCH_RATE_HZ: f64 = 4.0 * MAX_HZ;

/// Length of a spectrum's frame in seconds: resolves 1.25 kHz and follows the mains' envelope.
const FRAME_S: f64 = 0.8e-3;

/// Frames per frame length: each begins an eighth later.
pub(super) const HOPS_PER_FRAME: usize = 8;

/// Least power of a line at the user's frequency relative to the strongest line; a third harmonic is weaker.
const MIN_POWER_RATIO: f64 = 0.1;

/// Strongest line of one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Frequency in hertz.
    pub(super) f_hz: f64,
    /// Power relative to the channels' own.
    pub(super) power: f64,
    /// Power over the median of the band.
    pub(super) contrast: f64,
}

/// Strongest lines of all frames.
pub(super) struct Lines {
    /// Lines by frame, in order of time.
    pub(super) frames: Vec<Line>,
    /// Number of samples that are averaged into one.
    pub(super) every: usize,
    /// Index of the run's first sample.
    pub(super) first: usize,
    /// Index after the run's last sample.
    last: usize,
    /// Averaged samples from frame to frame.
    hop: usize,
    /// Averaged samples per frame.
    pub(super) length: usize,
}

impl Lines {
    /// Computes the lines of a run, within a band in hertz.
    pub(super) fn compute(capture: &Capture, run: &Run, band_hz: (f64, f64)) -> Self {
        let every = ((1.0 / (run.dt_s * SEARCH_RATE_HZ)) as usize).max(1);
        let dt_s = run.dt_s * every as f64;
        let channels = [&capture.v_v, &capture.i_a].map(|x| {
            let x = averaged(&x[run.samples.clone()], every);
            let power = mean_square(&x);
            (x, power)
        });
        let n = channels[0].0.len();
        let length = ((FRAME_S / dt_s) as usize).clamp(1, n.max(1));
        let hop = (length / HOPS_PER_FRAME).max(1);
        let mut spectrum = Spectrum::new(length, dt_s, band_hz);
        let mut frames = Vec::new();
        let mut start = 0;
        while start + length <= n {
            let line = spectrum.line(
                channels
                    .iter()
                    .map(|(x, p)| (&x[start..start + length], *p)),
            );
            frames.push(line);
            start += hop;
        }
        Self {
            frames,
            every,
            first: run.samples.start,
            last: run.samples.end,
            hop,
            length,
        }
    }

    /// First sample that frame `k` represents; that of the first frame is the beginning of the run.
    pub(super) fn begin(&self, k: usize) -> usize {
        if k == 0 { self.first } else { self.middle(k) }
    }

    /// Sample after the last that frame `k` represents.
    pub(super) fn end(&self, k: usize) -> usize {
        if k + 1 >= self.frames.len() {
            self.last
        } else {
            self.middle(k)
        }
    }

    /// Frames of a range whose windows lie within these samples; all of them if none does.
    pub(super) fn within(&self, samples: &Range<usize>, frames: &Range<usize>) -> Range<usize> {
        let half = self.length / 2 * self.every;
        let inside = |k: &usize| {
            let middle = self.middle(*k);
            middle >= samples.start + half && middle + half <= samples.end
        };
        match (frames.clone().find(inside), frames.clone().rfind(inside)) {
            (Some(first), Some(last)) => first..last + 1,
            _ => frames.clone(),
        }
    }

    /// Index of the sample in the middle of frame `k`.
    pub(super) fn middle(&self, k: usize) -> usize {
        self.first + (k * self.hop + self.length / 2) * self.every
    }
}

fn averaged(x: &[f32], every: usize) -> Vec<f64> {
    let scale = 1.0 / every as f64;
    let mut means = vec![0.0; x.len() / every];
    vectorised(
        #[inline(always)]
        || {
            for (mean, x) in means.iter_mut().zip(x.chunks_exact(every)) {
                *mean = scale * sum(x);
            }
        },
    );
    means
}

/// Spectrum of Hann-windowed frames of voltage and current together, each relative to its own power.
struct Spectrum {
    fft: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    power: Vec<f64>,
    bins: Range<usize>,
    /// Bins of all switching frequencies that a hob can have.
    all: Range<usize>,
    hz_per_bin: f64,
}

impl Spectrum {
    fn new(length: usize, dt_s: f64, (from_hz, to_hz): (f64, f64)) -> Self {
        // Twice the length, so that the top of a line is within a third of a bin of a parabola.
        let n = (2 * length).next_power_of_two().max(8);
        let fft = fourier::forward(n);
        let hz_per_bin = 1.0 / (dt_s * n as f64);
        let bin = |f: f64| ((f / hz_per_bin).max(1.0) as usize).min(n / 2 - 1);
        Self {
            window: fourier::periodic_hann(length),
            input: fft.make_input_vec(),
            output: fft.make_output_vec(),
            power: vec![0.0; n / 2 + 1],
            bins: bin(from_hz)..bin(to_hz) + 1,
            all: bin(MIN_HZ)..bin(MAX_HZ) + 1,
            hz_per_bin,
            fft,
        }
    }

    fn line<'a>(&mut self, channels: impl Iterator<Item = (&'a [f64], f64)>) -> Line {
        self.power.fill(0.0);
        for (x, mean_square) in channels {
            if mean_square <= 0.0 {
                continue;
            }
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            self.input.fill(0.0);
            for ((y, x), w) in self.input.iter_mut().zip(x).zip(&self.window) {
                *y = (x - mean) * w;
            }
            // The lengths are those of the plan.
            if self.fft.process(&mut self.input, &mut self.output).is_ok() {
                for (p, y) in self.power.iter_mut().zip(&self.output) {
                    *p += y.norm_sqr() / mean_square;
                }
            }
        }
        let (bins, power) = (self.bins.clone(), &self.power);
        let top = bins
            .clone()
            .max_by(|a, b| power[*a].total_cmp(&power[*b]))
            .unwrap_or(bins.start);
        let mut sorted = power[bins.clone()].to_vec();
        let middle = sorted.len() / 2;
        let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
        // A narrow band around a hint contains little but the line, so that the floor is taken from the whole spectrum.
        let mut all = power.clone();
        let middle = all.len() / 2;
        let (_, floor, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
        let floor = median.min(*floor).max(f64::MIN_POSITIVE);
        let strongest = power[self.all.clone()].iter().copied().fold(0.0, f64::max);
        let is_line = power[top] > 0.0
            && power[top] >= power[top - 1].max(power[top + 1])
            && power[top] >= MIN_POWER_RATIO * strongest;
        Line {
            f_hz: (top as f64 + self.summit(top)) * self.hz_per_bin,
            power: power[top],
            contrast: if is_line { power[top] / floor } else { 0.0 },
        }
    }

    /// Position of the top between the bins, by a parabola through three logarithms.
    fn summit(&self, top: usize) -> f64 {
        let log = |k: usize| self.power[k].max(f64::MIN_POSITIVE).ln();
        let (a, b, c) = (log(top - 1), log(top), log(top + 1));
        let curvature = a - 2.0 * b + c;
        if curvature < 0.0 {
            (0.5 * (a - c) / curvature).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn a_line_is_found_between_the_bins() {
        let (f, dt_s) = (45_123.0, 1.0 / SEARCH_RATE_HZ);
        let x: Vec<f64> = (0..480)
            .map(|k| (TAU * f * dt_s * f64::from(k)).cos())
            .collect();
        let mut spectrum = Spectrum::new(480, dt_s, (MIN_HZ, MAX_HZ));
        let line = spectrum.line([(x.as_slice(), 0.5)].into_iter());
        assert!((line.f_hz - f).abs() < 10.0, "{}", line.f_hz);
        assert!(line.contrast > 1e6);
    }
}
