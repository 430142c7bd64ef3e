//! Joint fit of a static load, a slow drift and tones within some kilohertz of the carrier.
//!
//! ```text
//! phasors ─► means of .1 ms ─► static law: misfit ─► + drift: misfit ─► + tones, one by one, or a step: misfit
//! ```
//!
//! The search by spectrum (`interference.rs`) sees a tone from five of its lines on, 250 Hz for two half-cycles; this one from
//! one turn in the stretch on, also at multiples of twice the mains frequency.

use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix2, Vector2};

use crate::lines::peak;
use crate::static_load::{Period, Space, weighed};

/// Length of a mean in seconds.
const MEAN_S: f64 = 0.1e-3;

/// Largest offset that is searched, in hertz: a mean of a tenth of a millisecond passes nine tenths of it.
const REACH_HZ: f64 = 2.4e3;

/// Misfit of the static law above which it does not hold: shares of R and L in percent.
pub const MISFIT_PCT: [f64; 2] = [0.35, 0.25];

/// Standard deviations of the noise's own misfit that must be exceeded besides.
const MISFIT_SIGMAS: f64 = 5.0;

/// Least gain of a tone over the variance that is left: chance reaches it in 1e-8 of searches.
const MIN_GAIN: f64 = 50.0;

/// Largest misfit beside the tones over that without them, for tones as its cause.
const MAX_MISFIT_RATIO: f64 = 0.35;

/// Least turns of a tone in the stretch: a slower one is a drift.
const MIN_TURNS: f64 = 0.8;

/// Least share of a tone that lies outside the load's space.
const MIN_OUTSIDE: f64 = 0.01;

/// Most tones.
const MAX_TONES: usize = 3;

/// Fewest means before and after a step.
const BESIDE_STEP: usize = 8;

/// Means from one place to the next at which a step is looked for first.
const STEP_STRIDE: usize = 4;

/// Numbers of a tone: frequency, amplitude, phase; those of a step beside its laws: its time.
const NUMBERS_OF_TONE: usize = 3;
const NUMBERS_OF_STEP: usize = 1;

/// Tone as it appears in the means.
#[derive(Clone, Debug)]
pub struct NearTone {
    /// Frequency less f_sw in hertz.
    pub offset_hz: f64,
    /// Amplitude and phase in volt at time zero.
    pub v: Complex<f64>,
    /// `true` if its amplitude follows the bus.
    pub follows_bus: bool,
}

/// Cause of a misfit.
#[derive(Clone, Debug)]
pub enum Cause {
    /// R and L are functions of the current alone.
    None,
    /// They drift, or a tone turns less than once.
    Drift,
    /// They step at this time in seconds: two functions of the current, which explain it.
    Step(f64),
    /// Tones, which explain it.
    Tones(Vec<NearTone>),
    /// Something else.
    Unknown,
}

/// Result of the fit.
#[derive(Clone, Debug)]
pub struct JointFit {
    /// Misfit of the static law, as shares of R and L in percent.
    pub misfit_pct: [f64; 2],
    /// Cause of the misfit.
    pub cause: Cause,
}

/// Means of phasors over `MEAN_S`.
pub struct Means {
    periods: Vec<Period>,
    /// Times of the means in seconds.
    pub t_s: Vec<f64>,
    /// |V| over its mean: the bus.
    pub bus: Vec<f64>,
    /// Variance that white noise leaves in |V|² of a mean, in V².
    white: Vec<f64>,
    /// Length of a mean in seconds.
    mean_s: f64,
}

/// Bayesian information criterion of a residual beside so many numbers: the lower, the likelier.
fn cost(left: &[f64], numbers: usize) -> f64 {
    let n = left.len() as f64;
    let power: f64 = left.iter().map(|x| x * x).sum();
    n * libm::log(power.max(f64::MIN_POSITIVE)) + numbers as f64 * libm::log(n)
}

impl Means {
    /// Averages phasors that lie `step_s` seconds apart; `white` is the variance of one sample of the unexplained voltage in V²,
    /// `sample_s` the distance of samples.
    pub fn new(
        phasors: &[Period],
        t0_s: f64,
        step_s: f64,
        white: impl Fn(&Period) -> f64,
        sample_s: f64,
    ) -> Self {
        let group = ((MEAN_S / step_s).round() as usize).max(1);
        let mean = |of: &[Period]| {
            let n = of.len() as f64;
            let sum = |f: fn(&Period) -> Complex<f64>| of.iter().map(f).sum::<Complex<f64>>() / n;
            Period {
                v: sum(|p| p.v),
                i: sum(|p| p.i),
                d: sum(|p| p.d),
                weight: of.iter().map(|p| p.weight).sum::<f64>() / n,
            }
        };
        let periods: Vec<Period> = phasors.chunks_exact(group).map(mean).collect();
        let middle_s = t0_s + 0.5 * (group - 1) as f64 * step_s;
        let t_s = (0..periods.len())
            .map(|k| middle_s + (k * group) as f64 * step_s)
            .collect();
        let mean_v = periods.iter().map(|p| p.weight * p.v.norm()).sum::<f64>()
            / periods
                .iter()
                .map(|p| p.weight)
                .sum::<f64>()
                .max(f64::MIN_POSITIVE);
        let bus = periods.iter().map(|p| p.v.norm() / mean_v).collect();
        let samples = group as f64 * step_s / sample_s;
        let white = periods.iter().map(|p| 4.0 * white(p) / samples).collect();
        Self {
            periods,
            t_s,
            bus,
            white,
            mean_s: group as f64 * step_s,
        }
    }

    /// Gain of a mean for a tone at an offset in hertz.
    pub fn passed(&self, offset_hz: f64) -> f64 {
        let x = 0.5 * TAU * offset_hz * self.mean_s;
        if x == 0.0 { 1.0 } else { libm::sin(x) / x }
    }

    fn lasts_s(&self) -> f64 {
        match (&self.t_s[..], self.t_s.len()) {
            ([first, .., last], n) => (last - first) * n as f64 / (n - 1) as f64,
            _ => 0.0,
        }
    }

    /// Fits; `None` if there is too little.
    pub fn fit(&self) -> Option<JointFit> {
        let mut space = Space::of_static_loads(&self.periods)?;
        if 2 * self.periods.len() < 4 * space.dimension() {
            return None;
        }
        let v = weighed(&self.periods, |_, p| p.v);
        let misfit_pct = self.misfit_pct(&space.outside(&v));
        let done = |cause| Some(JointFit { misfit_pct, cause });
        if !self.is_misfit(misfit_pct) {
            return done(Cause::None);
        }
        space.add_drift(&self.periods);
        if !self.is_misfit(self.misfit_pct(&space.outside(&v))) {
            return done(Cause::Drift);
        }
        let share = |pct: [f64; 2]| (pct[0] / MISFIT_PCT[0]).hypot(pct[1] / MISFIT_PCT[1]);
        let explains = |pct: &[f64; 2]| share(*pct) <= MAX_MISFIT_RATIO * share(misfit_pct);
        let tones = self.tones(&space, &v);
        let mut all = space.clone();
        tones.iter().for_each(|t| self.add(&mut all, t));
        let beside_tones = all.outside(&v);
        let by_tones = !tones.is_empty() && explains(&self.misfit_pct(&beside_tones));
        let tones_cost = cost(
            &beside_tones,
            all.dimension() + tones.len() * (NUMBERS_OF_TONE - 2),
        );
        let step = self.step(&space, &v).filter(|(_, left, numbers)| {
            explains(&self.misfit_pct(left)) && !(by_tones && tones_cost < cost(left, *numbers))
        });
        done(match step {
            Some((at, ..)) => Cause::Step(self.t_s[at]),
            None if by_tones => Cause::Tones(tones),
            None => Cause::Unknown,
        })
    }

    /// Most likely step: its mean, what is left with it, and its numbers; `None` if there are too few means.
    fn step(&self, whole: &Space, v: &[f64]) -> Option<(usize, Vec<f64>, usize)> {
        let n = self.periods.len();
        let of = |at: usize| {
            let mut space = whole.alike(&self.periods[..at])?;
            let mut after = whole.alike(&self.periods[at + 1..])?;
            space.widen(0, n - at);
            after.widen(at + 1, 0);
            space.join(after);
            let mut left = space.outside(v);
            // The step lies within this mean.
            (left[at], left[n + at]) = (0.0, 0.0);
            Some((at, left, space.dimension() + 2 + NUMBERS_OF_STEP))
        };
        let power = |left: &[f64]| left.iter().map(|x| x * x).sum::<f64>();
        let best = |places: &mut dyn Iterator<Item = usize>| {
            places
                .filter_map(of)
                .min_by(|a, b| power(&a.1).total_cmp(&power(&b.1)))
        };
        let (first, end) = (BESIDE_STEP, n.checked_sub(BESIDE_STEP)?);
        let (near, ..) = best(&mut (first..end).step_by(STEP_STRIDE))?;
        let from = near.saturating_sub(STEP_STRIDE - 1).max(first);
        best(&mut (from..(near + STEP_STRIDE).min(end)))
    }

    /// Root mean square of ΔR/R and ΔL/L that a residual means, without that of white noise, in percent.
    fn misfit_pct(&self, left: &[f64]) -> [f64; 2] {
        let (re, im) = left.split_at(self.periods.len());
        let (mut sums, mut weights) = ([0.0; 2], 0.0);
        for (k, p) in self.periods.iter().enumerate() {
            if p.weight <= 0.0 {
                continue;
            }
            // Weighed once more: at the crest noise costs least.
            let e = Complex::new(re[k], im[k]) / p.weight.sqrt();
            let z = p.v / p.i;
            let off = e / p.i;
            sums[0] +=
                p.weight * (off.re * off.re - 0.5 * self.white[k] / p.i.norm_sqr()) / z.re.powi(2);
            sums[1] +=
                p.weight * (off.im * off.im - 0.5 * self.white[k] / p.i.norm_sqr()) / z.im.powi(2);
            weights += p.weight;
        }
        sums.map(|s| 100.0 * (s / weights).max(0.0).sqrt())
    }

    /// Returns `true` if a misfit is large and no chance of the noise.
    fn is_misfit(&self, pct: [f64; 2]) -> bool {
        let n = self.periods.len() as f64;
        let weights: f64 = self.periods.iter().map(|p| p.weight).sum();
        let of = |part: fn(Complex<f64>) -> f64| {
            let each = self.periods.iter().zip(&self.white);
            let variance = each.map(|(p, white)| {
                p.weight * 0.5 * white
                    / p.i.norm_sqr().max(f64::MIN_POSITIVE)
                    / part(p.v / p.i).powi(2)
            });
            1e4 * variance.sum::<f64>() / weights
        };
        let noise = [of(|z| z.re), of(|z| z.im)];
        (0..2).any(|k| {
            let chance = MISFIT_SIGMAS * noise[k] * (2.0 / n).sqrt();
            pct[k] > MISFIT_PCT[k] && pct[k] * pct[k] > chance
        })
    }

    /// Columns of a tone's amplitude: its real and its imaginary part.
    fn columns(&self, offset_hz: f64, follows_bus: bool) -> [Vec<f64>; 2] {
        let turn = |k: usize| {
            let shape = if follows_bus { self.bus[k] } else { 1.0 };
            let (sin, cos) = libm::sincos(TAU * offset_hz * self.t_s[k]);
            Complex::new(shape * cos, shape * sin)
        };
        let re = weighed(&self.periods, |k, _| turn(k));
        let n = self.periods.len();
        let mut im = vec![0.0; 2 * n];
        for k in 0..n {
            (im[k], im[n + k]) = (-re[n + k], re[k]);
        }
        [re, im]
    }

    fn add(&self, space: &mut Space, tone: &NearTone) {
        for column in self.columns(tone.offset_hz, tone.follows_bus) {
            space.add(column);
        }
    }

    /// Fits one tone beside a space: its gain in squared residual and its amplitude in volt; `None` where it lies in the space.
    fn fit_tone(
        &self,
        space: &Space,
        left: &[f64],
        offset_hz: f64,
        follows_bus: bool,
    ) -> Option<(f64, Complex<f64>)> {
        let columns = self.columns(offset_hz, follows_bus);
        let inside = [space.inside(&columns[0]), space.inside(&columns[1])];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gram =
            Matrix2::from_fn(|a, b| dot(&columns[a], &columns[b]) - dot(&inside[a], &inside[b]));
        let whole = dot(&columns[0], &columns[0]);
        let right = Vector2::new(dot(&columns[0], left), dot(&columns[1], left));
        if gram.symmetric_eigenvalues().min() < MIN_OUTSIDE * whole {
            return None;
        }
        let v = gram.cholesky()?.solve(&right);
        Some((v.dot(&right), Complex::new(v[0], v[1])))
    }

    /// Larger gain of a tone at a frequency, and `true` if it is that of one that follows the bus.
    fn gain_and_kind(&self, space: &Space, left: &[f64], offset_hz: f64) -> (f64, bool) {
        let gain = |follows| {
            self.fit_tone(space, left, offset_hz, follows)
                .map_or(0.0, |x| x.0)
        };
        let (held, follows) = (gain(false), gain(true));
        if follows >= held {
            (follows, true)
        } else {
            (held, false)
        }
    }

    /// Searches for tones, the strongest first.
    fn tones(&self, loads: &Space, v: &[f64]) -> Vec<NearTone> {
        let lasts_s = self.lasts_s();
        let step_hz = 0.25 / lasts_s;
        let reach_hz = REACH_HZ.min(0.25 * self.t_s.len() as f64 / lasts_s);
        let steps = (reach_hz / step_hz) as i64;
        let least = (MIN_TURNS / lasts_s / step_hz).ceil() as i64;
        let mut tones: Vec<NearTone> = Vec::new();
        let mut space = loads.clone();
        while tones.len() < MAX_TONES {
            let left = space.outside(v);
            let places = (-steps..=steps).filter(|k| k.abs() >= least);
            let gain = |k: i64| self.gain_and_kind(&space, &left, k as f64 * step_hz).0;
            let Some((k, _)) = places
                .map(|k| (k, gain(k)))
                .max_by(|a, b| a.1.total_cmp(&b.1))
            else {
                break;
            };
            let Some(tone) = self.refined(&space, &left, k as f64 * step_hz, step_hz) else {
                break;
            };
            self.add(&mut space, &tone);
            tones.push(tone);
        }
        // Each once more beside all others.
        for k in 0..tones.len() {
            let mut others = loads.clone();
            for (n, tone) in tones.iter().enumerate() {
                if n != k {
                    self.add(&mut others, tone);
                }
            }
            let left = others.outside(v);
            if let Some(tone) = self.refined(&others, &left, tones[k].offset_hz, step_hz) {
                tones[k] = tone;
            }
        }
        tones
    }

    /// Tone at the gain's maximum near an offset; `None` if noise explains it.
    fn refined(
        &self,
        space: &Space,
        left: &[f64],
        near_hz: f64,
        reach_hz: f64,
    ) -> Option<NearTone> {
        let follows_bus = self.gain_and_kind(space, left, near_hz).1;
        let power = |hz: f64| {
            self.fit_tone(space, left, hz, follows_bus)
                .map_or(0.0, |x| x.0)
        };
        let offset_hz = peak(near_hz, reach_hz, power);
        let (gain, v) = self.fit_tone(space, left, offset_hz, follows_bus)?;
        let all: f64 = left.iter().map(|x| x * x).sum();
        let free = left
            .len()
            .checked_sub(space.dimension() + 3)
            .filter(|n| *n > 0)?;
        let variance = (all - gain).max(0.0) / free as f64;
        (gain > MIN_GAIN * variance).then_some(NearTone {
            offset_hz,
            v,
            follows_bus,
        })
    }
}
