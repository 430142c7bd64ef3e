//! Tones in the coil voltage that this hob does not make: another hob's coil beside it, or an edge that aliases next to
//! the carrier. Those near the carrier are fitted together with a static load ([`crate::joint`]), the others found in the spectrum
//! of what that load leaves. The cost of a tone is measured: least squares with it against least squares without it.

use std::f64::consts::{PI, TAU};

use ihd_identify::Estimate;
use ihd_identify::lockin::{Boxcar, demodulate};
use ihd_signal::carrier::Carrier;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};
use nalgebra::Complex;

use crate::comparison::{self, Difference};
use crate::joint::{Cause, JointFit, Means};
use crate::limits::{TOLERABLE_PCT, WARNING_SHARE};
use crate::lines::{Lines, peak};
use crate::static_load::{self, Period};

/// Most phasors that are searched together, because a tone need not last longer.
const MOST_PHASORS: usize = 8192;

/// Fewest phasors in which a tone is searched for.
const LEAST_PHASORS: usize = 128;

/// Switching periods of a boxcar: of two, three and four there is one that whole samples nearly fill, also at 61/3 samples
/// a period, so that the harmonics lie on its zeros.
const BOXCAR_PERIODS: f64 = 3.0;

/// Switching periods of the boxcar that confirms a tone: a tone seen by one boxcar only is that boxcar's artefact.
const CHECK_PERIODS: f64 = 5.0;

/// Largest difference between the two boxcars' results, as a share of the tone.
const SAME: f64 = 0.35;

/// Most tones that are removed from one stretch.
const MOST_TONES: usize = 6;

/// Share of [`TOLERABLE_PCT`] above which a tone is mentioned.
const INFO_SHARE: f64 = 0.2;

/// A tone beside the carrier.
#[derive(Clone, Debug, PartialEq)]
pub struct Tone {
    /// Frequency less f_sw, in hertz.
    pub offset_hz: f64,
    /// Amplitude and phase in volt, counted from the segment's first sample.
    pub v: Complex<f64>,
    /// Shape over time with a mean of 1: constant, or that of the bus.
    pub shape: Vec<f64>,
    /// Position of the shape's first value, and distance from one value to the next, in samples.
    pub place: (f64, f64),
    /// Samples of the part in which the tone was found, from the segment's first to its last where the part is at an end.
    pub reach: std::ops::Range<f64>,
    /// Error of R in percent that an estimator makes if it follows the tone; least squares follows up to about 1 kHz.
    pub may_cost_pct: f64,
    /// `true` if a harmonic of the inverter's own edges aliases to this frequency.
    pub alias: bool,
}

impl Tone {
    /// Calls with the tone's voltage in volt, sample by sample of a segment, up to `samples`.
    pub fn each(&self, segment: &Segment, samples: usize, mut each: impl FnMut(usize, f64)) {
        let periods = (segment.f_sw_hz + self.offset_hz) * segment.dt_s;
        for k in 0..samples {
            let Some(shape) = self.at(k) else {
                continue;
            };
            let (sin, cos) = libm::sincos(TAU * (periods * k as f64).fract());
            each(k, shape * (self.v.re * cos - self.v.im * sin));
        }
    }

    /// Shape at a sample, constant beyond its values; `None` outside the part in which the tone was searched for.
    fn at(&self, sample: usize) -> Option<f64> {
        if !self.reach.contains(&(sample as f64)) {
            return None;
        }
        let x = (sample as f64 - self.place.0) / self.place.1;
        let last = self.shape.len().checked_sub(1)?;
        let x = x.clamp(0.0, last as f64);
        let k = (x as usize).min(last.saturating_sub(1));
        let next = self.shape.get(k + 1).unwrap_or(&self.shape[k]);
        Some(self.shape[k] + (x - k as f64) * (next - self.shape[k]))
    }
}

/// Disturbances of a segment.
#[derive(Clone, Debug, Default)]
pub struct Interference {
    /// Tones beside the carrier.
    pub tones: Vec<Tone>,
    /// Fit of a static load, part by part; those parts without enough phasors are left out.
    pub fits: Vec<JointFit>,
}

impl Interference {
    /// Tones of other hobs, which can be removed; an alias is in both channels.
    pub fn neighbours(&self) -> impl Iterator<Item = &Tone> {
        self.tones.iter().filter(|tone| !tone.alias)
    }

    /// Time in seconds, from the segment's first sample, at which the load steps; `None` if it does not.
    fn step_s(&self) -> Option<f64> {
        self.fits.iter().find_map(|f| match f.cause {
            Cause::Step(t_s) => Some(t_s),
            _ => None,
        })
    }

    /// Warning that R and L are not functions of the current alone, and that no tone explains it; else `None`.
    pub fn law_remark(&self, segment: &Segment) -> Option<Remark> {
        if let Some(step_s) = self.step_s() {
            let t_s = segment.t0_s + step_s;
            let text = format!(
                "the load steps near {:.1} ms: before and after R and L are functions of the current, but not the same ones",
                t_s * 1e3
            );
            return Some(Remark::new("load_step", Severity::Warning, text).with(t_s, None));
        }
        let unexplained = |f: &&JointFit| matches!(f.cause, Cause::Drift | Cause::Unknown);
        let share = |f: &JointFit| {
            (f.misfit_pct[0] / TOLERABLE_PCT[0]).max(f.misfit_pct[1] / TOLERABLE_PCT[1])
        };
        let all = self.fits.iter().filter(unexplained);
        let worst = all.max_by(|a, b| share(a).total_cmp(&share(b)))?;
        let [r_pct, l_pct] = worst.misfit_pct;
        let slowest_hz = 1.0 / (segment.len() as f64 * segment.dt_s);
        let why = match worst.cause {
            Cause::Drift => format!(
                "they drift: the pot moves, or another hob switches within {slowest_hz:.0} Hz of this one"
            ),
            _ => "the load steps or moves, or something that is no tone disturbs the voltage"
                .to_owned(),
        };
        let text = format!(
            "R and L are not functions of the current alone, by {r_pct:.1} and {l_pct:.1} %; {why}"
        );
        let worse = usize::from(l_pct / TOLERABLE_PCT[1] > r_pct / TOLERABLE_PCT[0]);
        let remark = Remark::new("load_moves", Severity::Warning, text);
        Some(remark.with(
            worst.misfit_pct[worse],
            Some(crate::joint::MISFIT_PCT[worse]),
        ))
    }
}

/// Remark on tones, from least squares with and without them; `None` if they cost nothing. Tones that were removed are no
/// error any more.
pub fn remark(
    segment: &Segment,
    tones: &[Tone],
    reference: &Estimate,
    cleaned: &Estimate,
    removed: bool,
) -> Option<Remark> {
    let strongest = tones
        .iter()
        .max_by(|a, b| a.v.norm().total_cmp(&b.v.norm()))?;
    let share =
        |d: &Difference| (d.mean_pct[0] / TOLERABLE_PCT[0]).max(d.mean_pct[1] / TOLERABLE_PCT[1]);
    let costs = comparison::differences(segment, reference, cleaned);
    let cost = costs
        .into_iter()
        .max_by(|a, b| share(a).total_cmp(&share(b)))?;
    // The share that windows shorter than those of least squares would see; an alias is not in the coil's voltage.
    let may_cost_pct = if strongest.alias {
        0.0
    } else {
        strongest.may_cost_pct
    };
    let severity = match share(&cost) {
        s if s > 1.0 && !removed => Severity::Error,
        s if s.max(may_cost_pct / TOLERABLE_PCT[0]) > WARNING_SHARE => Severity::Warning,
        s if s > INFO_SHARE => Severity::Info,
        _ => return None,
    };
    let text = format!(
        "a tone of {:.1} V lies {:+.3} kHz beside the switching frequency, at {:.2} kHz: it costs {:.1} % of R and \
         {:.1} % of L; {}",
        strongest.v.norm(),
        strongest.offset_hz * 1e-3,
        (segment.f_sw_hz + strongest.offset_hz) * 1e-3,
        cost.mean_pct[0],
        cost.mean_pct[1],
        match (strongest.alias, removed) {
            (true, _) => "it is an alias of the inverter's edges: sample at another rate",
            (false, false) => "switch the coil beside this one off",
            (false, true) if severity == Severity::Info => "it was removed",
            (false, true) =>
                "it was removed, and the sensors were not calibrated; better switch the coil beside this one off",
        }
    );
    let worse =
        usize::from(cost.mean_pct[1] / TOLERABLE_PCT[1] > cost.mean_pct[0] / TOLERABLE_PCT[0]);
    let remark = Remark::new("interference", severity, text);
    Some(remark.with(cost.mean_pct[worse], Some(TOLERABLE_PCT[worse])))
}

/// Returns the segment with these tones subtracted from its voltage.
pub fn remove_tones(segment: &Segment, tones: &[Tone]) -> Segment {
    let mut v_v = segment.v_v.to_vec();
    for tone in tones {
        tone.each(segment, v_v.len(), |k, v| v_v[k] -= v);
    }
    Segment {
        v_v: v_v.into(),
        ..segment.clone()
    }
}

/// Time in seconds on either side of a step that is left out: the mean of a tenth of a millisecond in which it lies, and a boxcar.
const STEP_S: f64 = 0.2e-3;

/// Longest part that is fitted jointly, in seconds: six half-cycles.
const JOINT_S: f64 = 60e-3;

/// Searches for tones, and checks whether R and L are functions of the current alone.
pub fn find(segment: &Segment) -> Interference {
    let mut found = Interference::default();
    let Some(mut residual) = Residual::of(segment, BOXCAR_PERIODS) else {
        return found;
    };
    let volt_per_pct = residual.volt_per_pct();
    found.fits = residual.joint_fits(segment, volt_per_pct, &mut found.tones);
    if !found.tones.is_empty() || !found.fits.iter().all(|f| matches!(f.cause, Cause::None)) {
        // A frequency that moves changes R and L; it is followed elsewhere.
        if Carrier::of(segment).is_some_and(|carrier| carrier.moves()) {
            return Interference::default();
        }
    }
    residual.subtract(&found.tones);
    let step_s = found.step_s();
    if let Some(step_s) = step_s {
        residual.split(step_s);
    }
    let aliases = aliases_hz(segment);
    let chunks = residual.periods.len().div_ceil(MOST_PHASORS).max(1);
    let length = residual.periods.len() / chunks;
    let mut far: Vec<Tone> = (0..chunks)
        .flat_map(|k| {
            residual.tones(
                k * length..(k + 1) * length,
                volt_per_pct,
                &aliases,
                segment,
            )
        })
        .collect();
    if !far.is_empty() {
        let mut check = Residual::of(segment, CHECK_PERIODS);
        if let Some(check) = &mut check {
            check.subtract(&found.tones);
            if let Some(step_s) = step_s {
                check.split(step_s);
            }
        }
        far.retain(|tone| check.as_ref().is_some_and(|check| check.confirms(tone)));
    }
    found.tones.extend(far);
    found
}

/// Frequencies beside the carrier to which harmonics beyond half the sampling rate fold, in hertz from the carrier.
fn aliases_hz(segment: &Segment) -> Vec<f64> {
    let rate_hz = 1.0 / segment.dt_s;
    let most = (3.0 * segment.samples_per_period()).min(400.0) as usize;
    let folded = |h: usize| {
        let hz = h as f64 * segment.f_sw_hz;
        (hz - (hz / rate_hz).round() * rate_hz).abs() - segment.f_sw_hz
    };
    (2..=most).map(folded).collect()
}

/// Samples per switching period below which edges of 0.2 µs have strong harmonics beyond half the sampling rate.
const COARSE: f64 = 150.0;

/// Offset in hertz up to which the lock-in's boxcars of 0.1 ms let a tone through.
const LOCKIN_HZ: f64 = 10e3;

/// Returns `true` if a harmonic of the edges folds to a frequency that the lock-in passes and least squares does not: then
/// the error is the lock-in's.
pub fn disturbs_lockin(segment: &Segment) -> bool {
    let passed = |hz: &f64| (FOLLOWED_HZ..LOCKIN_HZ).contains(&hz.abs());
    segment.samples_per_period() < COARSE && aliases_hz(segment).iter().any(passed)
}

/// Offset in hertz up to which least squares follows a tone: half a wave in each of its intervals of 0.4 ms.
const FOLLOWED_HZ: f64 = 1.2e3;

/// Voltage that R and L, as functions of the current's amplitude, leave unexplained, phasor by phasor.
struct Residual {
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
    fn of(segment: &Segment, periods: f64) -> Option<Self> {
        let (per_period, f_sw_hz) = (segment.samples_per_period(), segment.f_sw_hz);
        let boxcar = Boxcar::fitting(per_period, f_sw_hz, periods / f_sw_hz);
        let phasors = demodulate(segment, boxcar);
        if phasors.len() < LEAST_PHASORS {
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

    /// Position of phasor `k` in samples of the segment.
    fn sample(&self, k: usize) -> f64 {
        self.place.0 + k as f64 * self.place.1
    }

    /// Samples of a part of so many phasors; those at the ends include the segment's ends.
    fn reach(&self, part: usize, parts: usize, length: usize) -> std::ops::Range<f64> {
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
    fn volt_per_pct(&self) -> f64 {
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
    fn joint_fits(
        &self,
        segment: &Segment,
        volt_per_pct: f64,
        tones: &mut Vec<Tone>,
    ) -> Vec<JointFit> {
        let noise = WhiteNoise::measure(segment);
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
    fn split(&mut self, step_s: f64) {
        let at = (step_s / self.dt_s - self.place.0) / self.place.1;
        let beside = STEP_S / (self.place.1 * self.dt_s);
        let n = self.periods.len();
        let before = ((at - beside).max(0.0) as usize).min(n);
        let after = ((at + beside).max(0.0).ceil() as usize).clamp(before, n);
        let of = |range: std::ops::Range<usize>| {
            let length = range.len();
            static_load::residual(&self.periods[range])
                .unwrap_or_else(|| vec![Complex::new(0.0, 0.0); length])
        };
        let step = vec![Complex::new(0.0, 0.0); after - before];
        self.v = [of(0..before), step, of(after..n)].concat();
    }

    /// Subtracts tones from the phasors.
    fn subtract(&mut self, tones: &[Tone]) {
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

    fn tones(
        &self,
        range: std::ops::Range<usize>,
        volt_per_pct: f64,
        aliases_hz: &[f64],
        segment: &Segment,
    ) -> Vec<Tone> {
        let n = range.len();
        let hann = |k: usize| 0.5 - 0.5 * libm::cos(TAU * (k as f64 + 0.5) / n as f64);
        let weight: Vec<f64> = (0..n)
            .map(|k| hann(k) * self.periods[range.start + k].weight)
            .collect();
        let sum: f64 = weight.iter().sum();
        if n < LEAST_PHASORS || sum <= 0.0 {
            return Vec::new();
        }
        let bus_v = || self.periods[range.clone()].iter().map(|p| p.v.norm());
        let mean_v = bus_v().zip(&weight).map(|(v, w)| v * w).sum::<f64>() / sum;
        let shapes = [vec![1.0; n], bus_v().map(|v| v / mean_v).collect()];
        let spacing_hz = 1.0 / (n as f64 * self.place.1 * self.dt_s);
        // The sidebands of the bus belong to the alias.
        let reach_hz = 2.0 * spacing_hz + 4.0 * segment.mains_hz;
        let is_alias = |line: i64| {
            let hz = line as f64 * spacing_hz;
            aliases_hz.iter().any(|a| (a - hz).abs() < reach_hz)
        };
        let mut left = self.v[range.clone()].to_vec();
        let amplitude = |x: &[Complex<f64>], shape: &[f64], hz: f64| {
            let terms = x.iter().zip(&weight).zip(shape).enumerate();
            let sum: Complex<f64> = terms
                .map(|(k, ((x, w), s))| x * (w * s) * self.turn(hz, range.start + k))
                .sum();
            let power: f64 = weight.iter().zip(shape).map(|(w, s)| w * s * s).sum();
            (sum / power, sum.norm_sqr() / power)
        };
        let mut tones = Vec::new();
        while tones.len() < MOST_TONES {
            let lines = Lines::of(&left, &weight);
            let Some(line) = lines.and_then(|lines| lines.strongest(is_alias)) else {
                break;
            };
            let power = |hz: f64| amplitude(&left, &shapes[0], hz).1;
            let offset_hz = peak(line as f64 * spacing_hz, spacing_hz, power);
            let explained = |shape: &&Vec<f64>| amplitude(&left, shape, offset_hz).1;
            let shape = shapes
                .iter()
                .max_by(|a, b| explained(a).total_cmp(&explained(b)));
            let Some(shape) = shape else {
                break;
            };
            let (v, _) = amplitude(&left, shape, offset_hz);
            let may_cost_pct = v.norm() / volt_per_pct.max(f64::MIN_POSITIVE);
            if may_cost_pct < INFO_SHARE * TOLERABLE_PCT[0] {
                break;
            }
            for (k, (x, s)) in left.iter_mut().zip(shape).enumerate() {
                *x -= v * *s * self.turn(offset_hz, range.start + k).conj();
            }
            tones.push(Tone {
                offset_hz,
                v: v / self.passed(offset_hz).max(0.1),
                shape: shape.clone(),
                place: (self.sample(range.start), self.place.1),
                reach: self.reach(range.start / n, self.periods.len() / n, n),
                may_cost_pct,
                alias: is_alias(line),
            });
        }
        tones
    }

    /// Returns `true` if this boxcar sees the same tone.
    fn confirms(&self, tone: &Tone) -> bool {
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
        (seen - tone.v).norm() < SAME * tone.v.norm()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use ihd_identify::{IdentifyOptions, Method, run};

    use super::*;

    const OMEGA: f64 = TAU * 45e3;

    /// Two half-cycles through 3 Ω and 18 µH, with a tone in the voltage and white noise of 50 dB.
    fn segment(offset_hz: f64, v: f64) -> Segment {
        let dt_s = 80e-9;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut noise = |sigma: f64| -> f64 {
            let x: f64 = StandardNormal.sample(&mut rng);
            sigma * x
        };
        let (mut v_v, mut i_a) = (Vec::new(), Vec::new());
        for k in 0..250_000 {
            let t = f64::from(k) * dt_s;
            let (mains, turn) = (TAU * 50.0, OMEGA * t);
            let (envelope, slope) = (
                40.0 * (mains * t).sin().abs(),
                40.0 * mains * (mains * t).cos() * (mains * t).sin().signum(),
            );
            let i = envelope * turn.cos();
            let d = slope * turn.cos() - envelope * OMEGA * turn.sin();
            let tone = v * ((OMEGA + TAU * offset_hz) * t + 0.7).cos();
            v_v.push(3.0 * i + 18e-6 * d + tone + noise(0.4));
            i_a.push(i + noise(0.06));
        }
        Segment {
            f_sw_hz: 45e3,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s,
            v_v: v_v.into(),
            i_a: i_a.into(),
        }
    }

    fn reference(segment: &Segment) -> Estimate {
        run(Method::LeastSquares, segment, &IdentifyOptions::default()).expect("a steady load")
    }

    #[test]
    fn a_tone_is_found_where_it_is_and_taken_out_it_costs_nothing() {
        for (offset_hz, v) in [
            (1200.0, 8.0),
            (-2_030.0, 4.0),
            (730.0, 2.0),
            (100.0, 4.0),
            (-300.0, 4.0),
            (79.0, 4.0),
        ] {
            let with = segment(offset_hz, v);
            let tones = find(&with).tones;
            let strongest = tones
                .iter()
                .max_by(|a, b| a.v.norm().total_cmp(&b.v.norm()));
            let found = strongest.expect("a tone");
            assert!((found.offset_hz - offset_hz).abs() < 8.0, "{found:?}");
            assert!((found.v.norm() / v - 1.0).abs() < 0.1, "{found:?}");
            let clean = segment(0.0, 0.0);
            let error = |s: &Segment| {
                let all = comparison::differences(&clean, &reference(s), &reference(&clean));
                all.iter().map(|d| d.mean_pct[0]).fold(0.0, f64::max)
            };
            let (before, after) = (error(&with), error(&remove_tones(&with, &tones)));
            assert!(
                after < 0.25 * before,
                "{offset_hz}: {before} % to {after} %"
            );
        }
    }

    #[test]
    fn there_is_no_tone_where_there_is_none() {
        let clean = segment(0.0, 0.0);
        let found = find(&clean);
        assert_eq!(found.tones, []);
        assert!(found.law_remark(&clean).is_none(), "{:?}", found.fits);
    }
}
