//! Tones that belong to somebody else: another hob's coil beside this one, or an edge that aliases next to the
//! carrier. They lie beside f_sw, where neither harmonics nor the mains' sidebands are, and what they cost is measured:
//! least squares with them against least squares without.

use std::f64::consts::{LN_2, PI, TAU};

use ihd_identify::least_squares::LeastSquaresSettings;
use ihd_identify::lockin::{Boxcar, Phasors, demodulate};
use ihd_identify::trajectory::Trajectory;
use ihd_identify::{Estimate, Method, Settings, run};
use ihd_signal::noise::median;
use ihd_signal::{Remark, Segment, Severity};
use nalgebra::Complex;
use realfft::RealFftPlanner;

use crate::comparison::{self, Difference};
use crate::judge::{TOLERABLE_PCT, WARNING_SHARE};

/// Phasors that are looked at together: a tone need not last longer.
const MOST_PHASORS: usize = 8192;

/// Fewest phasors in which a tone is looked for.
const LEAST_PHASORS: usize = 128;

/// Intervals of R and L in a half-cycle that the load is given here: what moves faster is left for the tones.
const SMOOTH_INTERVALS: usize = 8;

/// Switching periods of a boxcar: among two, three and four there is one that whole samples nearly fill, at 61/3 samples
/// a period too, so that the harmonics lie on its zeros.
const BOXCAR_PERIODS: f64 = 3.0;

/// Power of a line over the mean of its neighbours. White noise exceeds it once in 1e13 lines.
const LINE: f64 = 30.0;

/// Power over that at the mirrored offset: the load's own changes have both sides, a tone has one.
const ONE_SIDED: f64 = 4.0;

/// Lines on either side that make up the floor.
const NEIGHBOURS: usize = 32;

/// Lines that the window's main lobe covers on either side.
const LOBE: usize = 4;

/// Largest offset that is looked at, as a share of the phasors' rate, which is about f_sw.
const MOST_OFFSET: f64 = 0.25;

/// Tones that are taken out of one stretch at most.
const MOST_TONES: usize = 6;

/// Share of [`TOLERABLE_PCT`] from which on a tone is mentioned at all.
const INFO_SHARE: f64 = 0.2;

/// Offset in hertz up to which least squares follows a tone fully: half a wave in each of its intervals of 0.4 ms.
const FOLLOWED_HZ: f64 = 1.2e3;

/// A tone beside the carrier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Its frequency less f_sw, in hertz.
    pub offset_hz: f64,
    /// Its amplitude and phase in volt, counted from the segment's first sample.
    pub v: Complex<f64>,
    /// Samples in which it was found.
    pub samples: (usize, usize),
}

/// The remark on tones that cost something; `None` without.
pub fn remark(segment: &Segment, reference: &Estimate) -> Option<Remark> {
    let tones = find(segment, reference);
    let strongest = tones
        .iter()
        .max_by(|a, b| a.v.norm().total_cmp(&b.v.norm()))?;
    let cleaned = run(
        Method::LeastSquares,
        &without(segment, &tones),
        &Settings::default(),
    )
    .ok()?;
    let share =
        |d: &Difference| (d.mean_pct[0] / TOLERABLE_PCT[0]).max(d.mean_pct[1] / TOLERABLE_PCT[1]);
    let costs = comparison::differences(segment, reference, &cleaned);
    let cost = costs
        .into_iter()
        .max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let severity = match share(&cost) {
        s if s > 1.0 => Severity::Error,
        s if s > WARNING_SHARE => Severity::Warning,
        s if s > INFO_SHARE => Severity::Info,
        _ => return None,
    };
    let text = format!(
        "a tone of {:.1} V lies {:+.2} kHz beside the switching frequency, at {:.2} kHz: it costs {:.1} % of R and \
         {:.1} % of L; switch the coil beside this one off, or sample at another rate if it is an alias",
        strongest.v.norm(),
        strongest.offset_hz * 1e-3,
        (segment.f_sw_hz + strongest.offset_hz) * 1e-3,
        cost.mean_pct[0],
        cost.mean_pct[1]
    );
    let remark = Remark::new("interference", severity, text);
    Some(remark.with(cost.mean_pct[0], Some(TOLERABLE_PCT[0])))
}

/// The segment without these tones.
pub fn without(segment: &Segment, tones: &[Tone]) -> Segment {
    let mut v_v = segment.v_v.clone();
    for tone in tones {
        let periods = (segment.f_sw_hz + tone.offset_hz) * segment.dt_s;
        let (from, to) = tone.samples;
        for (k, v) in v_v.iter_mut().enumerate().take(to).skip(from) {
            let (sin, cos) = libm::sincos(TAU * (periods * k as f64).fract());
            *v -= tone.v.re * cos - tone.v.im * sin;
        }
    }
    segment.with_samples(v_v, segment.i_a.clone())
}

/// Tones in what R and L leave of the voltage's fundamental.
pub fn find(segment: &Segment, reference: &Estimate) -> Vec<Tone> {
    let boxcar = Boxcar::fitting(
        segment.samples_per_period(),
        segment.f_sw_hz,
        BOXCAR_PERIODS / segment.f_sw_hz,
    );
    let smooth = Settings {
        least_squares: LeastSquaresSettings {
            impedance_intervals: SMOOTH_INTERVALS,
            ..LeastSquaresSettings::default()
        },
        ..Settings::default()
    };
    let Ok(load) = run(Method::LeastSquares, segment, &smooth) else {
        return Vec::new();
    };
    let phasors = demodulate(segment, boxcar);
    let Some(residual) = Residual::of(segment, &phasors, &load, boxcar) else {
        return Vec::new();
    };
    let least_v = residual.least_v(reference);
    let chunks = residual.v.len().div_ceil(MOST_PHASORS).max(1);
    let length = residual.v.len() / chunks;
    (0..chunks)
        .flat_map(|k| residual.tones(k * length..(k + 1) * length, &least_v))
        .collect()
}

/// V − R·I − L·dI/dt, phasor by phasor.
struct Residual {
    /// In volt.
    v: Vec<Complex<f64>>,
    /// Sine squared of the mains' phase: 1 at the crest, 0 where R and L have their kinks.
    weight: Vec<f64>,
    /// |I| in ampere.
    i_a: Vec<f64>,
    /// Index of the first phasor's centre, and from one to the next, in samples.
    centre: f64,
    stride: f64,
    dt_s: f64,
    /// Duration of a boxcar in seconds.
    boxcar_s: f64,
}

impl Residual {
    fn of(segment: &Segment, phasors: &[Phasors], load: &Estimate, boxcar: Boxcar) -> Option<Self> {
        if phasors.len() < LEAST_PHASORS {
            return None;
        }
        let omega = TAU * segment.f_sw_hz;
        let half_s = segment.half_cycle_s();
        let mut trajectory = Trajectory::from(load, f64::NEG_INFINITY)?;
        let stride = phasors[1].centre - phasors[0].centre;
        let mut out = Self {
            v: Vec::with_capacity(phasors.len()),
            weight: Vec::with_capacity(phasors.len()),
            i_a: Vec::with_capacity(phasors.len()),
            centre: phasors[1].centre,
            stride,
            dt_s: segment.dt_s,
            boxcar_s: boxcar.samples() as f64 * segment.dt_s,
        };
        for w in phasors.windows(3) {
            let t_s = segment.t0_s + w[1].centre * segment.dt_s;
            let (r, l) = trajectory.r_l(t_s);
            let slope = (w[2].i - w[0].i) / (2.0 * stride * segment.dt_s);
            let d = w[1].i * Complex::new(0.0, omega) + slope;
            out.v.push(w[1].v - w[1].i * r - d * l);
            let sin = libm::sin(PI * segment.since_crossing_s(t_s) / half_s);
            out.weight.push(sin * sin);
            out.i_a.push(w[1].i.norm());
        }
        Some(out)
    }

    /// Time of phasor `k` after the segment's first sample, in seconds.
    fn t_s(&self, k: usize) -> f64 {
        (self.centre + k as f64 * self.stride) * self.dt_s
    }

    /// Smallest amplitude in volt, by offset in hertz, that may cost [`INFO_SHARE`] of what is tolerable. A tone turns:
    /// its mean share of R is 2/π.
    fn least_v(&self, reference: &Estimate) -> impl Fn(f64) -> f64 + use<> {
        let weights: f64 = self.weight.iter().sum();
        let weighted = self.i_a.iter().zip(&self.weight).map(|(i, w)| i * w);
        let i_a = weighted.sum::<f64>() / weights.max(f64::MIN_POSITIVE);
        let r_ohm = median(reference.r_ohm.clone()).unwrap_or(0.0).abs();
        move |offset_hz| {
            let followed = (FOLLOWED_HZ / offset_hz.abs()).min(1.0).powi(4);
            0.5 * PI * 1e-2 * INFO_SHARE * TOLERABLE_PCT[0] * i_a * r_ohm / followed
        }
    }

    fn tones(&self, range: std::ops::Range<usize>, least_v: &impl Fn(f64) -> f64) -> Vec<Tone> {
        let n = range.len();
        let hann = |k: usize| 0.5 - 0.5 * libm::cos(TAU * (k as f64 + 0.5) / n as f64);
        let weight: Vec<f64> = (0..n)
            .map(|k| hann(k) * self.weight[range.start + k])
            .collect();
        let sum: f64 = weight.iter().sum();
        if n < LEAST_PHASORS || sum <= 0.0 {
            return Vec::new();
        }
        let mut left: Vec<_> = self.v[range.clone()].to_vec();
        let spacing_hz = 1.0 / (n as f64 * self.stride * self.dt_s);
        let at = |k: f64| self.centre + (range.start as f64 + k) * self.stride;
        let samples = (at(-0.5).max(0.0) as usize, at(n as f64 - 0.5) as usize);
        let turn =
            |hz: f64, k: usize| Complex::from_polar(1.0, -TAU * hz * self.t_s(range.start + k));
        let mean = |x: &[Complex<f64>], hz: f64| -> Complex<f64> {
            let terms = x.iter().zip(&weight).enumerate();
            terms
                .map(|(k, (x, w))| x * *w * turn(hz, k))
                .sum::<Complex<f64>>()
                / sum
        };
        let mut found = Vec::new();
        while found.len() < MOST_TONES {
            let Some(line) = strongest_line(&left, &weight) else {
                break;
            };
            let power = |hz: f64| mean(&left, hz).norm_sqr();
            let offset_hz = peak(line as f64 * spacing_hz, spacing_hz, power);
            let v = mean(&left, offset_hz);
            if v.norm() < least_v(offset_hz) {
                break;
            }
            for (k, x) in left.iter_mut().enumerate() {
                *x -= v * turn(offset_hz, k).conj();
            }
            let x = PI * offset_hz * self.boxcar_s;
            let passed = if x == 0.0 {
                1.0
            } else {
                (libm::sin(x) / x).powi(2)
            };
            found.push(Tone {
                offset_hz,
                v: v / passed.max(0.1),
                samples,
            });
        }
        found
    }
}

/// The strongest line that stands out of its neighbours and of its mirror image, by its signed number.
fn strongest_line(x: &[Complex<f64>], weight: &[f64]) -> Option<i64> {
    let n = x.len();
    let power = spectrum(x, weight)?;
    let of = |k: i64| power[k.rem_euclid(n as i64) as usize];
    // Beyond, the kernel's first zero is near.
    let most = (MOST_OFFSET * n as f64) as i64;
    let stands_out = |k: &i64| {
        let around = (LOBE..LOBE + NEIGHBOURS).flat_map(|d| [of(k - d as i64), of(k + d as i64)]);
        let floor = median(around.collect()).unwrap_or(f64::INFINITY) / LN_2;
        let mirror = (-k - 1..=-k + 1).map(of).fold(0.0, f64::max);
        of(*k) > LINE * floor && of(*k) > ONE_SIDED * mirror
    };
    let lines = (-most..=most).filter(|k| k.unsigned_abs() as usize > LOBE);
    let is_peak = |k: &i64| of(*k) >= of(k - 1) && of(*k) >= of(k + 1);
    let candidates = lines.filter(is_peak).filter(stands_out);
    candidates.max_by(|a, b| of(*a).total_cmp(&of(*b)))
}

/// Power of each line of a complex signal, those of negative frequency in the upper half.
fn spectrum(x: &[Complex<f64>], weight: &[f64]) -> Option<Vec<f64>> {
    let n = x.len();
    let fft = RealFftPlanner::new().plan_fft_forward(n);
    let transformed = |part: fn(&Complex<f64>) -> f64| {
        let mut input: Vec<f64> = x.iter().zip(weight).map(|(x, w)| part(x) * w).collect();
        let mut output = fft.make_output_vec();
        fft.process(&mut input, &mut output).ok()?;
        Some(output)
    };
    let (re, im) = (transformed(|x| x.re)?, transformed(|x| x.im)?);
    let mut power = vec![0.0; n];
    for (k, (re, im)) in re.iter().zip(&im).enumerate() {
        // X = Re + j·Im; the mirrored line takes the conjugates of both.
        power[k] = (re.re - im.im).powi(2) + (re.im + im.re).powi(2);
        if k > 0 {
            power[n - k] = (re.re + im.im).powi(2) + (re.im - im.re).powi(2);
        }
    }
    Some(power)
}

/// Where `power` is largest within one line of `hz`, by ternary search.
fn peak(hz: f64, spacing_hz: f64, power: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (hz - spacing_hz, hz + spacing_hz);
    for _ in 0..24 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if power(a) < power(b) {
            low = a;
        } else {
            high = b;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

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
            v_v,
            i_a,
        }
    }

    fn reference(segment: &Segment) -> Estimate {
        run(Method::LeastSquares, segment, &Settings::default()).expect("a steady load")
    }

    #[test]
    fn a_tone_is_found_where_it_is_and_taken_out_it_costs_nothing() {
        for (offset_hz, v) in [(1200.0, 8.0), (-2_030.0, 4.0), (730.0, 2.0)] {
            let with = segment(offset_hz, v);
            let tones = find(&with, &reference(&with));
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
            let (before, after) = (error(&with), error(&without(&with, &tones)));
            assert!(
                after < 0.25 * before,
                "{offset_hz}: {before} % to {after} %"
            );
        }
    }

    #[test]
    fn there_is_no_tone_where_there_is_none() {
        let clean = segment(0.0, 0.0);
        assert_eq!(find(&clean, &reference(&clean)), []);
    }
}
