//! Voltage that a static load leaves unexplained, and the tones in it.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use ihd_identify::lockin::{Boxcar, LockInPhasors, demodulate};
use ihd_signal::Segment;
use ihd_signal::fourier::hann;
use ihd_signal::noise::WhiteNoise;
use nalgebra::Complex;

use super::tone::Tone;
use crate::joint::{Cause, JointFit, Means};
use crate::limits::{INFO_SHARE, TOLERABLE_PCT};
use crate::lines::{Lines, peak};
use crate::static_load::{self, Period};

/// Fewest phasors in which a tone is searched for.
const MIN_PHASORS: usize = 128;

/// Most tones that are removed from one stretch.
const MAX_TONES: usize = 6;

/// Largest difference between the two boxcars' results, as a share of the tone.
const MAX_BOXCAR_DIFFERENCE: f64 = 0.35;

/// Time in seconds on either side of a step that is left out: the mean of a tenth of a millisecond in which it lies, and a boxcar.
const STEP_S: f64 = 0.2e-3;

/// Longest part that is fitted jointly, in seconds: six half-cycles.
const JOINT_S: f64 = 60e-3;

/// Voltage that R and L, as functions of the current's amplitude, leave unexplained, phasor by phasor.
pub(super) struct Residual {
    /// Phasors, weighted with the sine squared of the mains' phase: 1 at the crest, 0 where R and L have their kinks.
    periods: Vec<Period>,
    /// Unexplained voltage in volt.
    v: Vec<Complex<f64>>,
    /// Position of the first phasor's centre, and distance from one to the next, in samples.
    place: (f64, f64),
    dt_s: f64,
    /// Duration of a boxcar in seconds.
    boxcar_s: f64,
}

impl Residual {
    /// Demodulates a segment with a boxcar of so many switching periods; `None` if it has too few phasors.
    pub(super) fn demodulate(segment: &Segment, periods: f64) -> Option<Self> {
        let boxcar = Boxcar::of_periods(segment, periods);
        Self::from_phasors(segment, boxcar, &demodulate(segment, boxcar))
    }

    /// Takes phasors of a segment behind a boxcar; `None` if they are too few.
    pub(super) fn from_phasors(
        segment: &Segment,
        boxcar: Boxcar,
        phasors: &[LockInPhasors],
    ) -> Option<Self> {
        let f_sw_hz = segment.f_sw_hz;
        if phasors.len() < MIN_PHASORS {
            return None;
        }
        let omega = TAU * f_sw_hz;
        let half_s = segment.half_cycle_s();
        let stride = phasors[1].centre - phasors[0].centre;
        let mut periods = Vec::with_capacity(phasors.len());
        for w in phasors.windows(3) {
            let t_s = segment.t0_s + w[1].centre * segment.dt_s;
            let slope = (w[2].i - w[0].i) / (2.0 * stride * segment.dt_s);
            let sin = libm::sin(PI * segment.since_crossing_s(t_s) / half_s);
            periods.push(Period {
                v: w[1].v,
                i: w[1].i,
                d: w[1].i * Complex::new(0.0, 1.0) + slope / omega,
                weight: sin * sin,
            });
        }
        Some(Self {
            v: static_load::residual(&periods)?,
            periods,
            place: (phasors[1].centre, stride),
            dt_s: segment.dt_s,
            boxcar_s: boxcar.samples() as f64 * segment.dt_s,
        })
    }

    /// Number of phasors.
    pub(super) fn len(&self) -> usize {
        self.periods.len()
    }

    /// Position of phasor `k` in samples of the segment.
    fn sample(&self, k: usize) -> f64 {
        self.place.0 + k as f64 * self.place.1
    }

    /// Samples of a part of so many phasors; those at the ends include the segment's ends.
    fn reach(&self, part: usize, parts: usize, length: usize) -> Range<f64> {
        let from = match part {
            0 => 0.0,
            _ => self.sample(part * length),
        };
        let to = match part + 1 < parts {
            true => self.sample((part + 1) * length),
            false => f64::INFINITY,
        };
        from..to
    }

    /// e^(−jωt) of an offset in hertz at phasor `k`.
    fn turn(&self, offset_hz: f64, k: usize) -> Complex<f64> {
        Complex::from_polar(1.0, -TAU * offset_hz * self.sample(k) * self.dt_s)
    }

    /// Gain of both boxcars for a tone at this offset in hertz.
    fn passed(&self, offset_hz: f64) -> f64 {
        let x = PI * offset_hz * self.boxcar_s;
        if x == 0.0 {
            1.0
        } else {
            (libm::sin(x) / x).powi(2)
        }
    }

    /// Amplitude in volt of a tone that costs 1 % of R if it is followed. A tone rotates: its mean share of R is 2/π.
    pub(super) fn volt_per_pct(&self) -> f64 {
        let weights: f64 = self.periods.iter().map(|p| p.weight).sum();
        let mean = |of: fn(&Period) -> f64| {
            let weighted = self.periods.iter().map(|p| p.weight * of(p));
            weighted.sum::<f64>() / weights.max(f64::MIN_POSITIVE)
        };
        // Power over the squared current is R.
        let r_ohm =
            mean(|p| (p.v * p.i.conj()).re) / mean(|p| p.i.norm_sqr()).max(f64::MIN_POSITIVE);
        (0.5 * PI * 1e-2 * mean(|p| p.i.norm()) * r_ohm.abs()).max(f64::MIN_POSITIVE)
    }

    /// Fits a static load and tones to parts of the segment, and adds the tones.
    pub(super) fn joint_fits(
        &self,
        noise: WhiteNoise,
        volt_per_pct: f64,
        tones: &mut Vec<Tone>,
    ) -> Vec<JointFit> {
        let white = |p: &Period| {
            let z2 = (p.v.norm_sqr() / p.i.norm_sqr().max(f64::MIN_POSITIVE)).min(1e6);
            noise.v_v * noise.v_v + z2 * noise.i_a * noise.i_a
        };
        let step_s = self.place.1 * self.dt_s;
        let parts = (self.periods.len() as f64 * step_s / JOINT_S)
            .ceil()
            .max(1.0) as usize;
        let length = self.periods.len() / parts;
        let mut fits = Vec::new();
        for part in 0..parts {
            let from = part * length;
            let t0_s = self.sample(from) * self.dt_s;
            let phasors = &self.periods[from..from + length];
            let means = Means::new(phasors, t0_s, step_s, white, self.dt_s);
            let Some(fit) = means.fit() else {
                continue;
            };
            if let Cause::Tones(near) = &fit.cause {
                for tone in near {
                    let passed = self.passed(tone.offset_hz) * means.passed(tone.offset_hz);
                    let spacing = match &means.t_s[..] {
                        [a, b, ..] => (b - a) / self.dt_s,
                        _ => self.place.1,
                    };
                    let shape = match tone.follows_bus {
                        true => means.bus.clone(),
                        false => vec![1.0; means.bus.len()],
                    };
                    tones.push(Tone {
                        offset_hz: tone.offset_hz,
                        v: tone.v / passed,
                        shape,
                        place: (means.t_s[0] / self.dt_s, spacing),
                        reach: self.reach(part, parts, length),
                        may_cost_pct: tone.v.norm() / volt_per_pct,
                        alias: false,
                    });
                }
            }
            fits.push(fit);
        }
        fits
    }

    /// Takes one law before a step and another after it, at a time in seconds from the segment's first sample.
    pub(super) fn split(&mut self, step_s: f64) {
        let at = (step_s / self.dt_s - self.place.0) / self.place.1;
        let beside = STEP_S / (self.place.1 * self.dt_s);
        let n = self.periods.len();
        let before = ((at - beside).max(0.0) as usize).min(n);
        let after = ((at + beside).max(0.0).ceil() as usize).clamp(before, n);
        let of = |range: Range<usize>| {
            let length = range.len();
            static_load::residual(&self.periods[range])
                .unwrap_or_else(|| vec![Complex::new(0.0, 0.0); length])
        };
        let step = vec![Complex::new(0.0, 0.0); after - before];
        self.v = [of(0..before), step, of(after..n)].concat();
    }

    /// Subtracts tones from the phasors.
    pub(super) fn subtract(&mut self, tones: &[Tone]) {
        if tones.is_empty() {
            return;
        }
        for tone in tones {
            let passed = self.passed(tone.offset_hz);
            for k in 0..self.periods.len() {
                if let Some(shape) = tone.at(self.sample(k).max(0.0) as usize) {
                    let turn = self.turn(tone.offset_hz, k).conj();
                    self.periods[k].v -= tone.v * (shape * passed) * turn;
                }
            }
        }
        if let Some(left) = static_load::residual(&self.periods) {
            self.v = left;
        }
    }

    /// Tones in a range of phasors, the strongest first, down to one that costs too little to be mentioned.
    pub(super) fn tones(
        &self,
        range: Range<usize>,
        volt_per_pct: f64,
        aliases_hz: &[f64],
        segment: &Segment,
    ) -> Vec<Tone> {
        let n = range.len();
        let Some(mut part) = WeightedPart::new(self, range.clone()) else {
            return Vec::new();
        };
        let shapes = part.shapes();
        let spacing_hz = 1.0 / (n as f64 * self.place.1 * self.dt_s);
        // The sidebands of the bus belong to the alias.
        let reach_hz = 2.0 * spacing_hz + 4.0 * segment.mains_hz;
        let is_alias = |line: i64| {
            let hz = line as f64 * spacing_hz;
            aliases_hz.iter().any(|a| (a - hz).abs() < reach_hz)
        };
        let mut tones = Vec::new();
        while tones.len() < MAX_TONES {
            let lines = Lines::compute(&part.left, &part.weight);
            let Some(line) = lines.and_then(|lines| lines.strongest(is_alias)) else {
                break;
            };
            let power = |hz: f64| part.amplitude(&shapes[0], hz).1;
            let offset_hz = peak(line as f64 * spacing_hz, spacing_hz, power);
            let explained = |shape: &&Vec<f64>| part.amplitude(shape, offset_hz).1;
            let shape = shapes
                .iter()
                .max_by(|a, b| explained(a).total_cmp(&explained(b)));
            let Some(shape) = shape else {
                break;
            };
            let (v, _) = part.amplitude(shape, offset_hz);
            let may_cost_pct = v.norm() / volt_per_pct.max(f64::MIN_POSITIVE);
            if may_cost_pct < INFO_SHARE * TOLERABLE_PCT[0] {
                break;
            }
            part.subtract(v, shape, offset_hz);
            tones.push(Tone {
                offset_hz,
                v: v / self.passed(offset_hz).max(0.1),
                shape: shape.clone(),
                place: (self.sample(range.start), self.place.1),
                reach: self.reach(range.start / n, self.len() / n, n),
                may_cost_pct,
                alias: is_alias(line),
            });
        }
        tones
    }

    /// Returns `true` if this boxcar sees the same tone.
    pub(super) fn confirms(&self, tone: &Tone) -> bool {
        let passed = self.passed(tone.offset_hz);
        let (mut sum, mut power) = (Complex::new(0.0, 0.0), 0.0);
        for (k, (x, p)) in self.v.iter().zip(&self.periods).enumerate() {
            let w = p.weight;
            if let Some(shape) = tone.at(self.sample(k).max(0.0) as usize) {
                sum += x * (w * shape) * self.turn(tone.offset_hz, k);
                power += w * shape * shape;
            }
        }
        let seen = sum / (power * passed).max(f64::MIN_POSITIVE);
        (seen - tone.v).norm() < MAX_BOXCAR_DIFFERENCE * tone.v.norm()
    }
}

/// Range of phasors in which tones are searched for.
struct WeightedPart<'a> {
    residual: &'a Residual,
    range: Range<usize>,
    /// Weights of the phasors: their own, with Hann's window.
    weight: Vec<f64>,
    /// Voltage in volt that the tones found so far leave.
    left: Vec<Complex<f64>>,
}

impl<'a> WeightedPart<'a> {
    /// Weights a range; `None` if it is too short for a tone, or has no weight.
    fn new(residual: &'a Residual, range: Range<usize>) -> Option<Self> {
        let n = range.len();
        let periods = residual.periods[range.clone()].iter();
        let weight: Vec<f64> = hann(n)
            .iter()
            .zip(periods)
            .map(|(w, p)| w * p.weight)
            .collect();
        let is_enough = n >= MIN_PHASORS && weight.iter().sum::<f64>() > 0.0;
        is_enough.then(|| Self {
            left: residual.v[range.clone()].to_vec(),
            residual,
            range,
            weight,
        })
    }

    /// Shapes that a tone may have over time: constant, and that of the bus, with a mean of 1.
    fn shapes(&self) -> [Vec<f64>; 2] {
        let periods = &self.residual.periods[self.range.clone()];
        let bus_v = || periods.iter().map(|p| p.v.norm());
        let weighted: f64 = bus_v().zip(&self.weight).map(|(v, w)| v * w).sum();
        let mean_v = weighted / self.weight.iter().sum::<f64>();
        [
            vec![1.0; periods.len()],
            bus_v().map(|v| v / mean_v).collect(),
        ]
    }

    /// Amplitude in volt of a tone of a shape at an offset in hertz, and the weighted square that it explains.
    fn amplitude(&self, shape: &[f64], hz: f64) -> (Complex<f64>, f64) {
        let terms = self.left.iter().zip(&self.weight).zip(shape).enumerate();
        let sum: Complex<f64> = terms
            .map(|(k, ((x, w), s))| x * (w * s) * self.residual.turn(hz, self.range.start + k))
            .sum();
        let weights = self.weight.iter().zip(shape);
        let power: f64 = weights.map(|(w, s)| w * s * s).sum();
        (sum / power, sum.norm_sqr() / power)
    }

    /// Subtracts a tone of a shape at an offset in hertz.
    fn subtract(&mut self, v: Complex<f64>, shape: &[f64], hz: f64) {
        for (k, (x, s)) in self.left.iter_mut().zip(shape).enumerate() {
            *x -= v * *s * self.residual.turn(hz, self.range.start + k).conj();
        }
    }
}
