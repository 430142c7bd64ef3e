//! Fit of one clipped channel by the other one.
//!
//! ```text
//! whole periods ─► Z of each harmonic over that of the fundamental ─┐
//! other channel ─► harmonics, period by period ─────────────────────┴─► x = c + Re g·y₁ + Σ harmonics ─► samples beyond the rail
//! ```
//!
//! A clipped sample tells only that its value lies beyond the rail. It is left out of the fit, and replaced by the mean value
//! beyond the rail that the fit expects.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::fourier::hann;
use nalgebra::{Complex, Matrix3, Vector3};

/// Switching periods of a window. Under a Hann window of four the harmonics lie on each other's zeros.
const WINDOW: usize = 4;

/// Highest harmonic of a voltage and of a current. On one side of an edge those beyond n sum up to 1/(π²·n) of it in the
/// fundamental; a current has bends only.
const MAX_HARMONICS: [usize; 2] = [127, 31];

/// Parts of a switching period over which the weights rise from a clipped sample on. A sharp end would turn the highest harmonics,
/// and the noise of the current's derivative, into the fundamental.
const TAPER: f64 = 16.0;

/// Rounds from a load to its harmonics and back: the third is some percent of the current, so that each gains two digits.
const ROUNDS: usize = 3;

/// Least amplitude of a whole window for the harmonics' laws, as a share of the largest.
const MIN_AMPLITUDE: f64 = 0.3;

type Phasor = Complex<f64>;

/// Samples of a span: the clipped channel and the complete one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair<'a> {
    /// Clipped channel.
    pub x: &'a [f32],
    /// Other channel.
    pub y: &'a [f32],
    /// `true` if the voltage is clipped.
    pub is_voltage: bool,
    /// Samples of a switching period.
    pub per_period: f64,
    /// Standard deviations of the noise of both.
    pub noise: [f64; 2],
    /// Ends of the range of the clipped channel, lower and upper.
    pub rails: [f64; 2],
}

/// Returns `true` if a sample lies within the ends of its channel's range.
pub(super) fn is_inside(x: f32, [low, high]: [f64; 2]) -> bool {
    (low..=high).contains(&f64::from(x))
}

/// Fit of a window.
#[derive(Clone, Copy, Debug)]
struct Fit {
    mean: f64,
    gain: Phasor,
}

/// Fundamental of the other channel and sum of the harmonics of the clipped one, sample by sample.
struct Parts {
    first: usize,
    y: Vec<Phasor>,
    harmonics: Vec<f64>,
}

/// Model of a span.
pub(super) struct Censored<'a> {
    pair: Pair<'a>,
    /// Weights of a window.
    hann: Vec<f64>,
    /// Harmonics of the other channel by window, from the first on.
    y: Vec<Vec<Phasor>>,
    /// `true` if no sample of the window lies beyond a rail.
    whole: Vec<bool>,
    /// Factors on R and L of each harmonic.
    ratios: Vec<(f64, f64)>,
    /// Impedance of the fundamental by window, in ohm.
    z: Vec<Phasor>,
    /// Amplitude of the clipped channel by window.
    amplitude: Vec<f64>,
}

impl<'a> Censored<'a> {
    /// Fits a span; `None` if no window of it is whole.
    pub(super) fn fit_span(pair: Pair<'a>) -> Option<Self> {
        let length = (WINDOW as f64 * pair.per_period).round() as usize;
        let periods = (pair.x.len() as f64 / pair.per_period) as usize;
        // The last window ends with the last whole period; a clipped sample behind it is restored by its fit.
        let windows = (periods + 1).checked_sub(WINDOW).filter(|n| *n > 0)?;
        let hann = hann(length).into_iter().map(|w| 2.0 * w).collect();
        let mut model = Self {
            pair,
            hann,
            y: Vec::new(),
            whole: Vec::new(),
            ratios: Vec::new(),
            z: Vec::new(),
            amplitude: Vec::new(),
        };
        let inside = |x: &f32| is_inside(*x, pair.rails);
        model.whole = (0..windows)
            .map(|p| pair.x[model.window(p)].iter().all(inside))
            .collect();
        model.y = (0..windows).map(|p| model.harmonics(pair.y, p)).collect();
        model.take_laws()?;
        for _ in 0..ROUNDS {
            model.refine();
        }
        Some(model)
    }

    fn window(&self, p: usize) -> Range<usize> {
        let first = (p as f64 * self.pair.per_period).round() as usize;
        let last = self.pair.x.len().saturating_sub(self.hann.len());
        first.min(last)..first.min(last) + self.hann.len()
    }

    /// Place of a sample among the windows' middles, in windows.
    fn place(&self, k: usize) -> f64 {
        (k as f64 + 0.5) / self.pair.per_period - 0.5 * WINDOW as f64
    }

    /// Phasors of a channel's harmonics in a window.
    fn harmonics(&self, x: &[f32], p: usize) -> Vec<Phasor> {
        let highest = MAX_HARMONICS[usize::from(!self.pair.is_voltage)];
        let highest = highest.min((0.5 * self.pair.per_period) as usize - 1);
        let mut sums = vec![Complex::new(0.0, 0.0); highest];
        for (k, w) in self.window(p).zip(&self.hann) {
            let turn = self.turn(k).conj();
            let mut by = turn * (f64::from(x[k]) * w);
            for sum in &mut sums {
                *sum += by;
                by *= turn;
            }
        }
        let scale = 2.0 / self.hann.len() as f64;
        sums.into_iter().map(|s| s * scale).collect()
    }

    /// e^(jωt) at a sample.
    fn turn(&self, k: usize) -> Phasor {
        let (sin, cos) = libm::sincos(TAU * (k as f64 / self.pair.per_period).fract());
        Complex::new(cos, sin)
    }

    /// Impedance from phasors of the clipped channel and of the other one.
    fn impedance(&self, x: Phasor, y: Phasor) -> Phasor {
        if self.pair.is_voltage { x / y } else { y / x }
    }

    /// Takes the harmonics' laws from the whole windows.
    fn take_laws(&mut self) -> Option<()> {
        let zero = Complex::new(0.0, 0.0);
        let windows = self.y.len();
        let x: Vec<Option<Vec<Phasor>>> = (0..windows)
            .map(|p| self.whole[p].then(|| self.harmonics(self.pair.x, p)))
            .collect();
        let largest = x.iter().flatten().map(|x| x[0].norm()).fold(0.0, f64::max);
        let counts = |x: &Vec<Phasor>| x[0].norm() > MIN_AMPLITUDE * largest;
        self.z = vec![zero; windows];
        self.amplitude = vec![0.0; windows];
        let highest = x.iter().flatten().find(|x| counts(x))?.len();
        self.ratios = vec![(1.0, 1.0); highest];
        // Variance of a phasor under the window.
        let share = 3.0 * 2.0 / self.hann.len() as f64;
        let [noise_v, noise_i] = match self.pair.is_voltage {
            true => self.pair.noise,
            false => [self.pair.noise[1], self.pair.noise[0]],
        };
        let mut sums = vec![[[0.0f64; 3]; 2]; highest];
        for (p, x) in x.iter().enumerate() {
            let Some(x) = x.as_ref().filter(|x| counts(x)) else {
                continue;
            };
            let y = &self.y[p];
            let z = self.impedance(x[0], y[0]);
            (self.z[p], self.amplitude[p]) = (z, x[0].norm());
            for (h, sums) in sums.iter_mut().enumerate().skip(1) {
                let (v, i) = match self.pair.is_voltage {
                    true => (x[h], y[h]),
                    false => (y[h], x[h]),
                };
                let order = (h + 1) as f64;
                let (a, b) = (i * z.re, i * Complex::new(0.0, order * z.im));
                let doubt = share * (noise_v * noise_v + (order * z.im * noise_i).powi(2));
                for (n, (c, z)) in [(a, z.re), (b, order * z.im)].into_iter().enumerate() {
                    sums[n][0] += (c.conj() * v).re;
                    sums[n][1] += c.norm_sqr() - share * (z * noise_i).powi(2);
                    sums[n][2] += doubt;
                }
            }
        }
        for (h, s) in sums.iter().enumerate().skip(1) {
            // Noise in place of a harmonic leaves the law of the harmonic two orders below it.
            let before = self.ratios[h.saturating_sub(2)];
            let of = |[product, power, doubt]: [f64; 3], before: f64| {
                let power = power.max(0.0) + doubt;
                if power > 0.0 {
                    (product + before * doubt) / power
                } else {
                    before
                }
            };
            self.ratios[h] = (of(s[0], before.0), of(s[1], before.1));
        }
        // Others begin with the load of the nearest one.
        let mut nearest = (0..windows).find(|p| self.amplitude[*p] > 0.0)?;
        for p in 0..windows {
            if self.amplitude[p] > 0.0 {
                nearest = p;
            } else {
                self.z[p] = self.z[nearest];
            }
        }
        Some(())
    }

    /// Returns `true` if a sample that a window's fit restores lies beyond a rail: the last one restores those behind it as well.
    fn restores(&self, p: usize) -> bool {
        let is_last = p + 1 == self.whole.len();
        let behind = self.pair.x.get(self.window(p).end..).unwrap_or(&[]);
        let clipped = |x: &f32| !is_inside(*x, self.pair.rails);
        !self.whole[p] || (is_last && behind.iter().any(clipped))
    }

    /// Fits the windows that are not whole with the harmonics of their present loads.
    fn refine(&mut self) {
        let mut fitted = Vec::new();
        for stretch in self.stretches() {
            let parts = self.parts(self.samples(&stretch));
            for p in stretch.filter(|p| !self.whole[*p]) {
                fitted.push((p, self.fit(&parts, p, self.pair.rails)));
            }
        }
        for (p, fit) in fitted {
            let Some(fit) = fit else { continue };
            let y = self.y[p][0];
            self.amplitude[p] = (fit.gain * y).norm();
            self.z[p] = self.impedance(fit.gain, Complex::new(1.0, 0.0));
        }
    }

    /// Runs of windows that restore samples, with another one on either side.
    fn stretches(&self) -> Vec<Range<usize>> {
        let mut out: Vec<Range<usize>> = Vec::new();
        for p in (0..self.whole.len()).filter(|p| self.restores(*p)) {
            let (from, to) = (p.saturating_sub(1), (p + 2).min(self.whole.len()));
            match out.last_mut() {
                Some(last) if last.end >= from => last.end = to,
                _ => out.push(from..to),
            }
        }
        out
    }

    /// Samples of a run of windows, up to the span's end if the last one is among them.
    fn samples(&self, windows: &Range<usize>) -> Range<usize> {
        let end = match windows.end == self.whole.len() {
            true => self.pair.x.len(),
            false => self.window(windows.end - 1).end,
        };
        self.window(windows.start).start..end
    }

    /// Impedance of a harmonic (0: the fundamental) in a window.
    fn of_harmonic(&self, p: usize, h: usize) -> Phasor {
        let (r, l) = self.ratios[h];
        Complex::new(r * self.z[p].re, l * (h + 1) as f64 * self.z[p].im)
    }

    fn parts(&self, samples: Range<usize>) -> Parts {
        let windows = self.y.len();
        // The windows on either side of a sample's place.
        let beside = |k: usize| {
            let at = self.place(k).clamp(0.0, (windows - 1) as f64);
            let p = (at as usize).min(windows.saturating_sub(2));
            (at, p, (p + 1).min(windows - 1))
        };
        let (first, last) = match samples.len() {
            0 => (0, 0),
            _ => (beside(samples.start).1, beside(samples.end - 1).2),
        };
        let clipped: Vec<Vec<Phasor>> = (first..=last)
            .map(|p| {
                let of = |(h, y): (usize, &Phasor)| {
                    let z = self.of_harmonic(p, h);
                    if self.pair.is_voltage { y * z } else { y / z }
                };
                self.y[p].iter().enumerate().map(of).collect()
            })
            .collect();
        let mut parts = Parts {
            first: samples.start,
            y: Vec::with_capacity(samples.len()),
            harmonics: Vec::with_capacity(samples.len()),
        };
        for k in samples {
            let (at, p, next) = beside(k);
            let w = at - p as f64;
            let turn = self.turn(k);
            parts
                .y
                .push((self.y[p][0] * (1.0 - w) + self.y[next][0] * w) * turn);
            let (mut by, mut sum) = (turn * turn, 0.0);
            let of_both = clipped[p - first].iter().zip(&clipped[next - first]);
            for (a, b) in of_both.skip(1) {
                sum += ((a * (1.0 - w) + b * w) * by).re;
                by *= turn;
            }
            parts.harmonics.push(sum);
        }
        parts
    }

    /// Mean and gain in a window from the samples inside the rails; `None` if they are too few.
    fn fit(&self, parts: &Parts, p: usize, rails: [f64; 2]) -> Option<Fit> {
        let window = self.window(p);
        let at = window.start.checked_sub(parts.first)?;
        let range = at..at + window.len();
        let (y, harmonics) = (parts.y.get(range.clone())?, parts.harmonics.get(range)?);
        let x = &self.pair.x[window];
        let (mut gram, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (k, weight) in self.weights(x, rails).into_iter().enumerate() {
            let columns = Vector3::new(1.0, y[k].re, -y[k].im);
            gram += columns * columns.transpose() * weight;
            right += columns * (weight * (f64::from(x[k]) - harmonics[k]));
        }
        let fit = gram.cholesky()?.solve(&right);
        fit.iter().all(|x| x.is_finite()).then(|| Fit::from(fit))
    }

    /// Weights of a window's samples: none beyond the rails, and less beside them.
    fn weights(&self, x: &[f32], rails: [f64; 2]) -> Vec<f64> {
        let reach = self.pair.per_period / TAPER;
        let inside = |x: &f32| is_inside(*x, rails);
        let mut distance = vec![f64::INFINITY; x.len()];
        let mut last = f64::INFINITY;
        for (x, distance) in x.iter().zip(&mut distance) {
            last = if inside(x) { last + 1.0 } else { 0.0 };
            *distance = last;
        }
        last = f64::INFINITY;
        for (x, distance) in x.iter().zip(&mut distance).rev() {
            last = if inside(x) { last + 1.0 } else { 0.0 };
            *distance = distance.min(last);
        }
        let taper = |d: f64| libm::sin(0.25 * TAU * (d / reach).min(1.0)).powi(2);
        let each = distance.into_iter().zip(&self.hann);
        each.map(|(d, hann)| hann * taper(d)).collect()
    }

    /// Mean of a sample of which the fit expects a value, given that it lies beyond the rail that was reached.
    fn expected(&self, fitted: f64, sample: f64, [low, high]: [f64; 2]) -> f64 {
        let (rail, sign) = if sample > high {
            (high, 1.0)
        } else {
            (low, -1.0)
        };
        let sigma = self.pair.noise[0].max(1e-6 * (high - low));
        fitted + sign * sigma * hazard(sign * (rail - fitted) / sigma)
    }

    /// Values of the samples beyond the rails: index and value.
    pub(super) fn values(&self) -> Vec<(usize, f32)> {
        let mut out = Vec::new();
        for stretch in self.stretches() {
            let samples = self.samples(&stretch);
            let parts = self.parts(samples.clone());
            let fits: Vec<Option<Fit>> = stretch
                .clone()
                .map(|p| self.fit(&parts, p, self.pair.rails))
                .collect();
            for k in samples {
                let x = self.pair.x[k];
                if is_inside(x, self.pair.rails) {
                    continue;
                }
                // The window whose middle is nearest.
                let n = (self.place(k).round().max(stretch.start as f64) as usize - stretch.start)
                    .min(fits.len() - 1);
                let Some(fit) = fits[n] else { continue };
                let j = k - parts.first;
                let fitted = fit.mean + (fit.gain * parts.y[j]).re + parts.harmonics[j];
                out.push((
                    k,
                    self.expected(fitted, f64::from(x), self.pair.rails) as f32,
                ));
            }
        }
        out
    }

    /// Errors of R and of L, as shares, by parts of `part` windows: the whole windows, of at least half of the largest amplitude,
    /// are clipped as the largest is, and fitted as that.
    pub(super) fn errors(&self, part: usize) -> Vec<[f64; 2]> {
        let largest = self.amplitude.iter().copied().fold(0.0, f64::max);
        let counts = |p: &usize| self.whole[*p] && self.amplitude[*p] >= 0.5 * largest;
        let windows: Vec<usize> = (0..self.whole.len()).filter(counts).collect();
        let of = |p: usize| {
            let parts = self.parts(self.window(p));
            let rails = self.pair.rails.map(|r| r * self.amplitude[p] / largest);
            let clipped = self.fit(&parts, p, rails)?.gain;
            let whole = self
                .fit(&parts, p, [f64::NEG_INFINITY, f64::INFINITY])?
                .gain;
            let one = Complex::new(1.0, 0.0);
            let (z, right) = (self.impedance(clipped, one), self.impedance(whole, one));
            Some([z.re / right.re - 1.0, z.im / right.im - 1.0])
        };
        windows
            .chunks(part.max(1))
            .filter_map(|part| {
                let all: Option<Vec<[f64; 2]>> = part.iter().map(|p| of(*p)).collect();
                let all = all?;
                let mean = |k: usize| all.iter().map(|e| e[k]).sum::<f64>() / all.len() as f64;
                Some([mean(0), mean(1)])
            })
            .collect()
    }
}

impl From<Vector3<f64>> for Fit {
    fn from(x: Vector3<f64>) -> Self {
        Self {
            mean: x[0],
            gain: Complex::new(x[1], x[2]),
        }
    }
}

/// Mean of a normal variable beyond `x`, in standard deviations.
fn hazard(x: f64) -> f64 {
    if x < -8.0 {
        return 0.0;
    }
    if x > 8.0 {
        // The asymptotic series, right to 1e-5 here.
        let per = 1.0 / (x * x);
        return x * (1.0 + per * (1.0 - per * (2.0 - 10.0 * per)));
    }
    let density = libm::exp(-0.5 * x * x) / TAU.sqrt();
    density / (0.5 * libm::erfc(x / 2f64.sqrt()))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// A current that grows to 1 A and clips at 0.9 A, through 4 Ω at 60°; it ends at a crest that belongs to no whole period.
    #[test]
    fn samples_are_restored_up_to_the_last_one() {
        const PER_PERIOD: usize = 50;
        const WHOLE: usize = 40 * PER_PERIOD;
        const SAMPLES: usize = WHOLE + 3;
        let wave = |k: usize, turns: f64| {
            let amplitude = 0.5 + 0.5 * k as f64 / SAMPLES as f64;
            amplitude * libm::cos(TAU * (k as f64 / PER_PERIOD as f64 + turns))
        };
        let full: Vec<f64> = (0..SAMPLES).map(|k| wave(k, 0.0)).collect();
        let x: Vec<f32> = full.iter().map(|x| x.clamp(-0.9, 0.9) as f32).collect();
        let y: Vec<f32> = (0..SAMPLES)
            .map(|k| (4.0 * wave(k, 1.0 / 6.0)) as f32)
            .collect();
        let pair = Pair {
            x: &x,
            y: &y,
            is_voltage: false,
            per_period: PER_PERIOD as f64,
            noise: [1e-4, 1e-4],
            rails: [-0.899, 0.899],
        };
        let restored = Censored::fit_span(pair).expect("whole windows").values();
        let beyond: Vec<usize> = (0..SAMPLES)
            .filter(|k| !is_inside(x[*k], pair.rails))
            .collect();
        assert!(beyond.iter().filter(|k| **k >= WHOLE).count() == 3);
        let places: Vec<usize> = restored.iter().map(|(k, _)| *k).collect();
        assert_eq!(places, beyond);
        for (k, value) in restored {
            // The other channel's phasor is held beyond the middle of the last window: two periods of growth are 2.5 %.
            assert!((f64::from(value) - full[k]).abs() < 0.05, "{k}: {value}");
        }
    }

    #[test]
    fn the_mean_beyond_a_place_is_that_of_the_normal_law() {
        // Mills' ratio: √(2/π) at zero; beyond a far place x + 1/x.
        assert!((hazard(0.0) - (2.0 / PI).sqrt()).abs() < 1e-12);
        assert!((hazard(1.0) - 1.525_135).abs() < 1e-6);
        assert!((hazard(8.0 + 1e-9) - hazard(8.0 - 1e-9)).abs() < 1e-4);
        assert!(hazard(-9.0).abs() < 1e-12);
    }
}
