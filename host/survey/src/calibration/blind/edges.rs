//! Phase of the carrier, and the phases at which the bridge switches.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::fourier::hann;
use ihd_signal::vectorised::vectorised;
use nalgebra::Complex;

use super::charge::{Charge, charge_c};
use super::samples::StretchSamples;
use crate::track::turned;

/// Evenly sampled stretch of a capture with one carrier.
#[derive(Clone, Debug)]
pub(super) struct Stretch<'a> {
    /// Coil voltage in volt.
    pub v_v: StretchSamples<'a>,
    /// Coil current in ampere; positive if positive voltage feeds power into the coil.
    pub i_a: StretchSamples<'a>,
    /// Time from sample to sample in seconds.
    pub dt_s: f64,
    /// Approximate switching frequency in hertz, from which the phase is tracked.
    pub f_sw_hz: f64,
}

/// State of the carrier at one sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carrier {
    /// Periods since an arbitrary origin.
    pub periods: f64,
    /// Amplitude of the bridge's voltage in volt.
    pub v_v: f64,
    /// Rate of change of `v_v` in volt per second.
    pub v_per_s: f64,
    /// Amplitude of the current in ampere.
    pub i_a: f64,
}

impl Carrier {
    /// State at a share of the way to the next one: beyond it the phase is extrapolated, amplitudes are held.
    #[inline(always)]
    fn towards(&self, next: &Self, share: f64) -> Self {
        let held = share.clamp(0.0, 1.0);
        Self {
            periods: self.periods + share * (next.periods - self.periods),
            v_v: self.v_v + held * (next.v_v - self.v_v),
            v_per_s: self.v_per_s + held * (next.v_per_s - self.v_per_s),
            i_a: self.i_a + held * (next.i_a - self.i_a),
        }
    }
}

/// Carrier along a stretch, linear between frames.
#[derive(Clone, Debug)]
pub(super) struct Track {
    hop: f64,
    first: f64,
    frames: Vec<Carrier>,
}

/// Carrier, and the phases at which the bridge does not switch.
#[derive(Clone, Debug)]
pub(super) struct Edges {
    pub track: Track,
    /// Phases between the edges in periods, from the end of one to the beginning of the next; the second may exceed 1.
    pub between: [Range<f64>; 2],
    pub charge: Charge,
}

/// Switching periods in a frame, and from frame to frame.
const FRAME: f64 = 4.0;
const HOP: f64 = 2.0;

/// Frames over which the change of the bus is computed.
const BUS_FRAMES: usize = 3;

/// Most steps whose median ratio is computed.
const MAX_STEPS: usize = 20_000;

/// Length of compared steps as a share of a period: an edge is longer, and noise of a single sample at 125 MS/s is more
/// than a fiftieth of an edge.
const STEP: f64 = 0.01;

impl Stretch<'_> {
    /// Number of samples per period.
    pub fn per_period(&self) -> f64 {
        1.0 / (self.f_sw_hz * self.dt_s)
    }

    /// 1/C in 1/farad: the median ratio of voltage steps to the charge that flowed. The few steps that contain an edge do not
    /// change the median.
    fn elastance(&self) -> Option<f64> {
        let m = ((0.05 * self.per_period()) as usize).max(1);
        let every = (self.v_v.len() / MAX_STEPS).max(1);
        let (mut i_buffer, mut q_c) = (Vec::new(), Vec::new());
        let mut flowed_c = |k: usize| {
            let i_a = self.i_a.block(k..k + m + 1, &mut i_buffer);
            charge_c(i_a, self.dt_s, &mut q_c);
            q_c[m] - q_c[0]
        };
        let mut steps: Vec<(f64, f64)> = (0..self.v_v.len().saturating_sub(m))
            .step_by(every)
            .map(|k| (self.v_v.at(k + m) - self.v_v.at(k), flowed_c(k)))
            .filter(|(_, q)| *q != 0.0)
            .map(|(v, q)| (-v / q, q.abs()))
            .collect();
        steps.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * steps.iter().map(|s| s.1).sum::<f64>();
        let mut sum = 0.0;
        let middle = steps.iter().find(|s| {
            sum += s.1;
            sum >= half
        });
        middle.map(|s| s.0).filter(|e| e.is_finite())
    }

    /// Tracks the phase of v + q/C, which is the bridge's; `None` if there are too few periods.
    fn track(&self, elastance: f64) -> Option<Track> {
        let samples = |periods: f64| (periods * self.per_period()).round() as usize;
        let (frame, hop) = (samples(FRAME), samples(HOP).max(1));
        if frame < 8 || self.v_v.len() < 4 * frame {
            return None;
        }
        let omega = TAU * self.f_sw_hz;
        let [cos, minus_sin] = &turned(&hann(frame), 4.0 / frame as f64, omega * self.dt_s);
        let of_weights = [cos, minus_sin].map(|weights| weights.iter().sum());
        let phasor = |x: &StretchSamples<'_>, from: usize| {
            let [re, im] = x.weighted_sums(from..from + frame, [cos, minus_sin], of_weights);
            Complex::new(re, im) * Complex::from_polar(1.0, -omega * self.dt_s * from as f64)
        };
        let mut frames = Vec::new();
        let mut last: f64 = 0.0;
        for from in (0..=self.v_v.len() - frame).step_by(hop) {
            let (v, i) = (phasor(&self.v_v, from), phasor(&self.i_a, from));
            let bridge = v + i * elastance / Complex::new(0.0, omega);
            let phase = bridge.arg() / TAU;
            last = phase + (last - phase).round();
            let middle = from as f64 + 0.5 * (frame - 1) as f64;
            frames.push(Carrier {
                periods: self.f_sw_hz * self.dt_s * middle + last,
                v_v: bridge.norm(),
                v_per_s: 0.0,
                i_a: i.norm(),
            });
        }
        let hop_s = hop as f64 * self.dt_s;
        for k in 0..frames.len() {
            let (a, b) = (
                k.saturating_sub(BUS_FRAMES),
                (k + BUS_FRAMES).min(frames.len() - 1),
            );
            frames[k].v_per_s = (frames[b].v_v - frames[a].v_v) / ((b - a).max(1) as f64 * hop_s);
        }
        let first = 0.5 * (frame - 1) as f64;
        Some(Track {
            hop: hop as f64,
            first,
            frames,
        })
    }

    /// Root mean square of steps of v + q/C by phase, each relative to the bridge's amplitude at that time.
    fn fold(&self, track: &Track, elastance: f64) -> Fold {
        let least_v = MIN_AMPLITUDE_SHARE * track.largest_v();
        let bins = (3.0 * self.per_period()).clamp(24.0, 512.0) as usize;
        let m = ((STEP * self.per_period()).round() as usize).max(1);
        let mut sums = vec![(0.0, 0u32); bins];
        let (mut squares, mut places) = ([0.0; WALKED], [0.0; WALKED]);
        let [mut v_buffer, mut i_buffer, mut q] = [const { Vec::new() }; 3];
        track.walk(m..self.v_v.len(), |range, between| {
            let (squares, places) = (&mut squares[..range.len()], &mut places[..range.len()]);
            let samples = range.start - m..range.end;
            let v = self.v_v.block(samples.clone(), &mut v_buffer);
            charge_c(self.i_a.block(samples, &mut i_buffer), self.dt_s, &mut q);
            vectorised(
                #[inline(always)]
                || {
                    for (k, place) in places.iter_mut().enumerate() {
                        *place = fraction(between.at(k).periods) * bins as f64;
                    }
                    for (step, (before, v)) in squares.iter_mut().zip(v.iter().zip(&v[m..])) {
                        *step = v - before;
                    }
                    for (step, (before, q)) in squares.iter_mut().zip(q.iter().zip(&q[m..])) {
                        *step += elastance * (q - before);
                    }
                    for (k, square) in squares.iter_mut().enumerate() {
                        let v_v = between.at(k).v_v;
                        let share = *square / v_v;
                        *square = if v_v < least_v { -1.0 } else { share * share };
                    }
                },
            );
            for (square, place) in squares.iter().zip(&*places) {
                if *square >= 0.0 {
                    let sum = &mut sums[(*place as usize).min(bins - 1)];
                    *sum = (sum.0 + square, sum.1 + 1);
                }
            }
        });
        let mut rms: Vec<Option<f64>> = sums
            .iter()
            .map(|(sum, n)| (*n > 0).then(|| (sum / f64::from(*n)).sqrt()))
            .collect();
        // At a sampling rate locked to f_sw only few phases occur; the others take the value of the next one.
        for k in (0..2 * bins).rev() {
            rms[k % bins] = rms[k % bins].or(rms[(k + 1) % bins]);
        }
        Fold {
            rms: rms.into_iter().map(|r| r.unwrap_or(0.0)).collect(),
            step: m as f64 / self.per_period(),
        }
    }

    /// Carrier, and the phases between its edges; `None` if nothing switches, or no two edges are found.
    pub fn edges(&self) -> Option<Edges> {
        let elastance = self.elastance()?;
        let track = self.track(elastance)?;
        Some(Edges {
            between: self.fold(&track, elastance).between_edges()?,
            charge: Charge::compute(&self.i_a, self.dt_s, self.per_period()),
            track,
        })
    }
}

/// Part of `x` beyond the next lower whole number, as `rem_euclid(1.0)` without a division.
#[inline(always)]
fn fraction(x: f64) -> f64 {
    let beyond = x - x.trunc();
    if beyond < 0.0 { beyond + 1.0 } else { beyond }
}

/// Share of the largest amplitude of the bridge's voltage from which a plateau is used: weaker ones have little weight.
pub(super) const MIN_AMPLITUDE_SHARE: f64 = 0.1;

/// Steps of v + q/C by phase.
struct Fold {
    rms: Vec<f64>,
    /// Length of a step in periods.
    step: f64,
}

/// Least excess of a step over the usual one, as a share of the largest, to be part of an edge.
const EDGE: f64 = 0.12;

/// Least ratio of the largest step to the usual one for edges to be detected.
const MIN_STEP_RATIO: f64 = 3.0;

impl Fold {
    fn between_edges(&self) -> Option<[Range<f64>; 2]> {
        let mut sorted = self.rms.clone();
        sorted.sort_by(f64::total_cmp);
        let (usual, most) = (sorted[sorted.len() / 2], *sorted.last()?);
        if most.is_nan() || most <= MIN_STEP_RATIO * usual {
            return None;
        }
        let limit = usual + EDGE * (most - usual);
        let bins = self.rms.len();
        let busy: Vec<usize> = (0..bins).filter(|k| self.rms[*k] > limit).collect();
        let first = *busy.first()?;
        let next = busy.iter().skip(1).copied().chain([first + bins]);
        let mut quiet: Vec<Range<f64>> = busy
            .iter()
            .zip(next)
            // A step is stored at its end, so that the edge ended one step before.
            .map(|(a, b)| {
                let of = |bin: usize| bin as f64 / bins as f64;
                of(a + 1) - self.step..of(b)
            })
            .collect();
        quiet.sort_by(|a, b| (b.end - b.start).total_cmp(&(a.end - a.start)));
        let [a, b] = quiet.get(..2)?.to_vec().try_into().ok()?;
        Some(if a.start <= b.start { [a, b] } else { [b, a] })
    }
}

/// Most samples of a stretch of [`Track::walk`].
const WALKED: usize = 512;

/// Carrier along samples between two frames.
struct CarrierStretch {
    ends: [Carrier; 2],
    /// Samples from the first frame to the first sample.
    before: f64,
    /// Share of the way from frame to frame that a sample takes.
    per_sample: f64,
}

impl CarrierStretch {
    /// State of the carrier at a sample, as [`Track::at`] has it.
    #[inline(always)]
    fn at(&self, k: usize) -> Carrier {
        let [a, b] = &self.ends;
        a.towards(b, (self.before + k as f64) * self.per_sample)
    }
}

/// Newton steps to the position of a phase: the frequency is within a few percent of the mean, so that each gives two digits.
const PLACE_STEPS: usize = 6;

impl Track {
    /// Position at which the phase reaches a number of periods, in samples from the first one.
    pub fn place(&self, periods: f64, per_period: f64) -> f64 {
        // The phase is linear between frames, with a slope close to its mean everywhere.
        let mut k = (periods - self.between(0.0).periods) * per_period;
        for _ in 0..PLACE_STEPS {
            k += (periods - self.between(k).periods) * per_period;
        }
        k
    }

    /// Visits all samples of a range in stretches of at most [`WALKED`], each between the same two frames.
    fn walk(&self, samples: Range<usize>, mut visit: impl FnMut(Range<usize>, CarrierStretch)) {
        let last = self.frames.len().saturating_sub(2);
        let mut k = samples.start;
        for (n, pair) in self.frames.windows(2).enumerate() {
            let middle = self.first + n as f64 * self.hop;
            let end = match n < last {
                true => samples.end.min((middle + self.hop).ceil() as usize),
                false => samples.end,
            };
            while k < end {
                let next = end.min(k + WALKED);
                let between = CarrierStretch {
                    ends: [pair[0], pair[1]],
                    before: k as f64 - middle,
                    per_sample: self.hop.recip(),
                };
                visit(k..next, between);
                k = next;
            }
        }
    }

    /// State of the carrier at sample `k`.
    pub fn at(&self, k: usize) -> Carrier {
        self.between(k as f64)
    }

    /// State of the carrier at a time in samples; extrapolated at both ends.
    fn between(&self, sample: f64) -> Carrier {
        let place = (sample - self.first) / self.hop;
        let last = self.frames.len().saturating_sub(2);
        let n = (place.max(0.0) as usize).min(last);
        self.frames[n].towards(&self.frames[n + 1], place - n as f64)
    }

    /// Largest amplitude of the bridge's voltage in volt.
    pub fn largest_v(&self) -> f64 {
        self.frames.iter().map(|f| f.v_v).fold(0.0, f64::max)
    }
}
