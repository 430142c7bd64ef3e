//! Lock-in demodulator at any sampling rate: heterodyne at f_sw, two boxcars (a CIC filter of order
//! two), then R and L from the phasors.
//!
//! Both boxcars span a whole number of switching periods, so that every harmonic falls on a zero of both. V and I pass the same
//! kernel, so that V = R·I + L·(jωI + dI/dt) holds behind it while R and L are constant within it. Near the zero crossings they
//! are not, which is the method's error.

use std::f64::consts::{PI, TAU};
use std::time::Instant;

use ihd_signal::Segment;
use ihd_signal::correlation::{BlockTurns, Correlator, HarmonicSums};
use ihd_signal::noise::WhiteNoise;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use super::{Estimate, IdentifyError, Method};

/// Options of the lock-in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LockinSettings {
    /// Duration of each boxcar in seconds; the nearest that contains whole periods is used.
    pub boxcar_s: f64,
    /// Share of the largest current amplitude below which R and L are held.
    pub hold_below: f64,
}

impl Default for LockinSettings {
    fn default() -> Self {
        Self {
            boxcar_s: 0.1e-3,
            hold_below: 0.01,
        }
    }
}

/// Length of a boxcar in blocks of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boxcar {
    /// Samples per block, which is the table's length.
    pub block: usize,
    /// Blocks per boxcar.
    pub blocks: usize,
}

/// Most samples of a block: a longer table exceeds the cache without being faster.
const MAX_BLOCK: usize = 64;

/// Multiples of f_sw, from the carrier, at which the double boxcar's gain counts: images and harmonics as far as the fifth.
const MULTIPLES: std::ops::RangeInclusive<u32> = 1..=6;

/// Distance of the sidebands in hertz: the amplitude follows the mains, so that the image and the harmonics are no single lines.
const SIDEBAND_HZ: f64 = 100.0;

/// Gain of a boxcar over `n` values for a frequency in turns from one value to the next.
fn boxcar_gain(n: f64, turns: f64) -> f64 {
    let one = libm::sin(PI * turns);
    if one.abs() < 1e-9 {
        return 1.0;
    }
    (libm::sin(PI * n * turns) / (n * one)).abs()
}

impl Boxcar {
    /// Chooses the boxcar of about so many switching periods of a segment, as [`Boxcar::fitting`].
    pub fn of_periods(segment: &Segment, periods: f64) -> Self {
        let f_sw_hz = segment.f_sw_hz;
        Self::fitting(segment.samples_per_period(), f_sw_hz, periods / f_sw_hz)
    }

    /// Chooses the boxcar nearest to `boxcar_s` seconds that lets the least of the image at twice f_sw and of the harmonics pass.
    ///
    /// The first boxcar sums samples, the second one sums of blocks: what turns by whole turns from block to block passes the second
    /// one undamped. A block of half a switching period leaves the image to the first boxcar alone, and a thousandth of it, beside a
    /// carrier that is sampled once a period, is a tone some hertz away.
    pub fn fitting(samples_per_period: f64, f_sw_hz: f64, boxcar_s: f64) -> Self {
        let ideal = (boxcar_s * f_sw_hz).round().max(1.0);
        let (from, to) = ((0.75 * ideal).floor().max(1.0), (1.25 * ideal).ceil());
        let mut best = (
            f64::INFINITY,
            Self {
                block: 1,
                blocks: 1,
            },
        );
        let mut periods = from;
        while periods <= to {
            let samples = periods * samples_per_period;
            for block in 1..=MAX_BLOCK {
                let blocks = (samples / block as f64).round().max(1.0) as usize;
                let boxcar = Self { block, blocks };
                // A long block is faster, the requested duration is more accurate.
                let distance = 1e-6 * ((periods - ideal).abs() / ideal + 2.0 / block as f64);
                let sideband = SIDEBAND_HZ / f_sw_hz;
                if let Some(passed) = boxcar.passed(samples_per_period, sideband, best.0)
                    && passed + distance < best.0
                {
                    best = (passed + distance, boxcar);
                }
            }
            periods += 1.0;
        }
        best.1
    }

    /// Largest share of the fundamental that its image or a square wave's harmonic adds, with sidebands at this share of f_sw; `None`
    /// from a limit on.
    fn passed(self, samples_per_period: f64, sideband: f64, limit: f64) -> Option<f64> {
        let gain = |multiple: f64| {
            let turns = multiple / samples_per_period;
            let first = boxcar_gain(self.samples() as f64, turns);
            first * boxcar_gain(self.blocks as f64, turns * self.block as f64)
        };
        let of = |multiple: u32| match f64::from(multiple) {
            // An offset has no sidebands.
            1.0 => gain(1.0),
            m => gain(m - sideband).max(gain(m + sideband)) / (m - 1.0),
        };
        MULTIPLES.map(of).try_fold(0.0, |largest: f64, share| {
            let largest = largest.max(share);
            (largest < limit).then_some(largest)
        })
    }

    /// Number of samples of a boxcar.
    pub fn samples(self) -> usize {
        self.block * self.blocks
    }
}

/// Phasors of the fundamental, amplitudes, and their time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LockInPhasors {
    /// Index of the kernel's centre, in samples.
    pub centre: f64,
    /// Coil voltage in volt.
    pub v: Complex<f64>,
    /// Coil current in ampere.
    pub i: Complex<f64>,
}

/// Streaming part of the lock-in: correlator and two running sums.
#[derive(Clone, Debug)]
pub struct Lockin {
    correlator: Correlator<1>,
    blocks: usize,
    first: Vec<[Complex<f64>; 2]>,
    second: Vec<[Complex<f64>; 2]>,
    first_sum: [Complex<f64>; 2],
    second_sum: [Complex<f64>; 2],
    taken: usize,
    /// Place of the next block among those of a boxcar.
    at: usize,
    turns: BlockTurns,
}

impl Lockin {
    /// Creates an empty demodulator for a segment's sampling.
    pub fn new(segment: &Segment, boxcar: Boxcar) -> Self {
        let zero = [Complex::new(0.0, 0.0); 2];
        let correlator = Correlator::new(segment, boxcar.block, [1.0]);
        Self {
            turns: BlockTurns::new(&correlator),
            correlator,
            blocks: boxcar.blocks,
            first: vec![zero; boxcar.blocks],
            second: vec![zero; boxcar.blocks],
            first_sum: zero,
            second_sum: zero,
            taken: 0,
            at: 0,
        }
    }

    /// Adds the next block of samples; returns phasors once both boxcars are full.
    pub fn push(&mut self, v_v: &[f64], i_a: &[f64]) -> Option<LockInPhasors> {
        let length = self.correlator.length();
        let turn = self.turns.next(&self.correlator);
        let HarmonicSums { v, i } = self.correlator.block_turned(&turn, v_v, i_a);
        let at = self.at;
        self.at = if at + 1 < self.blocks { at + 1 } else { 0 };
        for (k, new) in [v[0], i[0]].into_iter().enumerate() {
            self.first_sum[k] += new - self.first[at][k];
            self.first[at][k] = new;
            self.second_sum[k] += self.first_sum[k] - self.second[at][k];
            self.second[at][k] = self.first_sum[k];
        }
        self.taken += 1;
        if self.taken + 1 < 2 * self.blocks {
            return None;
        }
        let samples = (self.blocks * length) as f64;
        let scale = 2.0 / (samples * self.blocks as f64);
        let end = (self.taken * length) as f64;
        Some(LockInPhasors {
            centre: end - 0.5 * (samples + 1.0) - 0.5 * (samples - length as f64),
            v: self.second_sum[0] * scale,
            i: self.second_sum[1] * scale,
        })
    }
}

/// R in ohm and L in henry of V = R·I + L·D, D the phasor of di/dt: two real equations.
pub fn r_l(v: Complex<f64>, i: Complex<f64>, d: Complex<f64>) -> (f64, f64) {
    let determinant = i.re * d.im - i.im * d.re;
    (
        (v.re * d.im - v.im * d.re) / determinant,
        (i.re * v.im - i.im * v.re) / determinant,
    )
}

/// Blocks of samples that are converted to doubles at a time.
const BLOCKS_AT_ONCE: usize = 512;

/// Calls `each` with stretches of `length` samples, the last one shorter: index of the first sample, voltage, current.
pub(crate) fn for_chunks(
    segment: &Segment,
    length: usize,
    mut each: impl FnMut(usize, &[f64], &[f64]),
) {
    let (mut v_buffer, mut i_buffer) = (Vec::new(), Vec::new());
    for first in (0..segment.len()).step_by(length.max(1)) {
        let range = first..(first + length).min(segment.len());
        let v_v = segment.v_v.block(range.clone(), &mut v_buffer);
        each(first, v_v, segment.i_a.block(range, &mut i_buffer));
    }
}

/// Phasors of a whole segment, about one per switching period.
pub fn demodulate(segment: &Segment, boxcar: Boxcar) -> Vec<LockInPhasors> {
    let stride = (segment.samples_per_period() / boxcar.block as f64).round() as usize;
    let mut lockin = Lockin::new(segment, boxcar);
    let mut all = Vec::new();
    let (mut outputs, stride) = (0, stride.max(1));
    for_chunks(segment, boxcar.block * BLOCKS_AT_ONCE, |_, v_v, i_a| {
        let v_blocks = v_v.chunks_exact(boxcar.block);
        for (v, i) in v_blocks.zip(i_a.chunks_exact(boxcar.block)) {
            if let Some(phasors) = lockin.push(v, i) {
                if outputs % stride == 0 {
                    all.push(phasors);
                }
                outputs += 1;
            }
        }
    });
    all
}

/// Identifies by lock-in; `noise` is the segment's.
///
/// # Errors
/// [`ihd_signal::SegmentError::TooShort`] if the segment does not fill both boxcars.
pub fn identify(
    segment: &Segment,
    noise: WhiteNoise,
    settings: &LockinSettings,
) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let boxcar = Boxcar::fitting(
        segment.samples_per_period(),
        segment.f_sw_hz,
        settings.boxcar_s,
    );
    let phasors = demodulate(segment, boxcar);
    if phasors.len() < 3 {
        let boxcars = (2 * boxcar.samples()) as f64 / segment.samples_per_period();
        return Err(segment.too_short(boxcars + 3.0).into());
    }
    let omega = TAU * segment.f_sw_hz;
    let largest = phasors.iter().map(|p| p.i.norm()).fold(0.0, f64::max);
    // Variance of a phasor of white noise behind the triangle of both boxcars.
    let share = 2.0 * triangle_power(boxcar);
    let mut estimate = Estimate::new(Method::Lockin, segment.f_sw_hz);
    let mut sigma_held = 0.0;
    for w in phasors.windows(3) {
        let (before, p, after) = (&w[0], &w[1], &w[2]);
        let dt_s = (after.centre - before.centre) * segment.dt_s;
        let d = p.i * Complex::new(0.0, omega) + (after.i - before.i) / dt_s;
        let amplitude = p.i.norm();
        let t_s = segment.t0_s + p.centre * segment.dt_s;
        let load = r_l(p.v, p.i, d);
        if amplitude < settings.hold_below * largest || !(load.0 + load.1).is_finite() {
            if let Some((r, l)) = estimate.last() {
                estimate.push(t_s, (r, l), (sigma_held, sigma_held / omega));
            }
            continue;
        }
        let z2 = load.0 * load.0 + (omega * load.1) * (omega * load.1);
        let variance = noise.v_v * noise.v_v + z2 * noise.i_a * noise.i_a;
        let sigma = (share * variance).sqrt() / amplitude;
        sigma_held = sigma;
        estimate.push(t_s, load, (sigma, sigma / omega));
    }
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}

/// Σw² of the kernel's weights, which sum to 1: (2n² + 1)/(3n³) in blocks, spread over the samples.
fn triangle_power(boxcar: Boxcar) -> f64 {
    let n = boxcar.blocks as f64;
    (2.0 * n * n + 1.0) / (3.0 * n * n * n * boxcar.block as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sine whose amplitude is |sin| of the mains' phase, at rates where a block of half a period nearly fits, and at others.
    #[test]
    fn the_image_at_twice_the_frequency_is_no_tone() {
        let phasors = |f_sw_hz: f64, rate_hz: f64| {
            let of = |k: usize| {
                let t_s = k as f64 / rate_hz;
                (TAU * 50.0 * t_s).sin().abs() * (TAU * f_sw_hz * t_s).cos()
            };
            let x: Vec<f64> = (0..(0.02 * rate_hz) as usize).map(of).collect();
            let segment = Segment {
                f_sw_hz,
                mains_hz: 50.0,
                zero_crossing_s: 0.0,
                t0_s: 0.0,
                dt_s: 1.0 / rate_hz,
                v_v: x.clone().into(),
                i_a: x.into(),
            };
            let boxcar = Boxcar::fitting(rate_hz / f_sw_hz, f_sw_hz, 3.0 / f_sw_hz);
            demodulate(&segment, boxcar)
        };
        for (f_sw_hz, rate_hz) in [
            (70_095.2, 8e6),
            (66_597.9, 8e6),
            (69_477.0, 2.5e6),
            (67_900.0, 2.5e6),
            (45e3, 12.5e6),
            (45e3, 915e3),
        ] {
            // The phase is that of the carrier; at the crests the image would be all of the imaginary part.
            let worst = (phasors(f_sw_hz, rate_hz).iter())
                .filter(|p| (TAU * 50.0 * p.centre / rate_hz).sin().abs() > 0.7)
                .map(|p| (p.v.im / p.v.re).abs())
                .fold(0.0, f64::max);
            assert!(worst < 2e-5, "{f_sw_hz} Hz at {rate_hz} S/s: {worst}");
        }
    }
}
