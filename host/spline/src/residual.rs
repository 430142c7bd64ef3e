//! Residual of a fit of harmonic phasors at the fundamental, in windows along the stretch. The part that exceeds white noise is
//! an error of the model: a neighbour's coil, a frequency that moves, a step, or edges that the sampling folds beside the
//! fundamental. A standard deviation from white noise does not contain it.

use std::f64::consts::PI;

use ihd_signal::correlation::{BlockTurns, Correlator};
use nalgebra::Complex;

use crate::harmonic::{HarmonicFit, phasor};

type Phasor = Complex<f64>;

/// A window's length as a share of a spline's interval: its band is twice the spline's.
const WINDOW: f64 = 1.0;

/// Fewest switching periods of a window: its lobe of 3 bins keeps the other harmonics out.
const MIN_PERIODS: f64 = 6.0;

/// Windows per window length.
const OVERLAP: f64 = 4.0;

/// Share of white noise that the spline's own freedom leaves in a window.
const NOISE_SHARE_LEFT: f64 = 0.49;

/// Times of a window at which the fitted phasor is evaluated.
const TIMES: usize = 8;

/// Windows on either side that are averaged.
const NEIGHBOUR_WINDOWS: usize = 4;

/// Mean square relative to white noise that counts as chance: means of so many windows seldom exceed it.
const MAX_CHANCE_RATIO: f64 = 1.8;

/// Excess of a fit's residual at the fundamental over white noise, along the stretch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Excess {
    /// Time of the first window's middle in seconds after the first sample; `step_s` is the distance to the next.
    first_s: f64,
    step_s: f64,
    windows: Vec<ResidualWindow>,
    /// Squared amplitudes that count as chance, of voltage and current.
    chance: [f64; 2],
}

/// Mean squared amplitudes of the residuals around a window, and their product.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ResidualWindow {
    v: f64,
    i: f64,
    /// V·I*
    product: Phasor,
}

impl Excess {
    /// Computes the excess of a fit from its coefficients of voltage and current; `white` holds the standard deviations of
    /// their white noise per sample.
    pub fn compute(
        fit: &HarmonicFit<'_>,
        samples: [&[f64]; 2],
        fitted: [&[f64]; 2],
        white: [f64; 2],
    ) -> Self {
        let Some(windows) = Windows::new(fit, samples[0].len()) else {
            return Self::default();
        };
        let correlator = Correlator::with_rate(fit.periods_per_sample, windows.block, [1.0]);
        let mut turns = BlockTurns::new(&correlator);
        let blocks = samples[0]
            .chunks_exact(windows.block)
            .zip(samples[1].chunks_exact(windows.block))
            .map(|(v, i)| {
                let sums = correlator.block_turned(&turns.next(&correlator), v, i);
                [sums.v[0], sums.i[0]]
            });
        let blocks: Vec<[Phasor; 2]> = blocks.collect();
        let left: Vec<[Phasor; 2]> = (0..windows.count)
            .map(|w| windows.left(w, fit, &blocks, fitted))
            .collect();
        let means = (0..left.len()).map(|w| {
            let near = &left
                [w.saturating_sub(NEIGHBOUR_WINDOWS)..(w + NEIGHBOUR_WINDOWS + 1).min(left.len())];
            let n = near.len() as f64;
            ResidualWindow {
                v: near.iter().map(|[v, _]| v.norm_sqr()).sum::<f64>() / n,
                i: near.iter().map(|[_, i]| i.norm_sqr()).sum::<f64>() / n,
                product: near.iter().map(|[v, i]| v * i.conj()).sum::<Phasor>() / n,
            }
        });
        Self {
            first_s: 0.5 * windows.length_s(fit),
            step_s: (windows.hop * windows.block) as f64 * fit.dt_s,
            windows: means.collect(),
            chance: white
                .map(|sigma| MAX_CHANCE_RATIO * NOISE_SHARE_LEFT * sigma * sigma * windows.white),
        }
    }

    /// Mean squared amplitude of V − Z·I of the residuals beyond white noise, around a time in seconds after the first sample;
    /// zero if the stretch is shorter than a window.
    ///
    /// A neighbour's tone that was taken off the voltage still flows in the current, and through the load: it is in both residuals,
    /// costs nothing, and is not in this one.
    pub fn misfit(&self, tau_s: f64, z: Phasor) -> f64 {
        let place = ((tau_s - self.first_s) / self.step_s).round().max(0.0);
        let last = self.windows.len().saturating_sub(1);
        let Some(left) = self.windows.get((place as usize).min(last)) else {
            return 0.0;
        };
        let z2 = z.norm_sqr();
        let square = left.v + z2 * left.i - 2.0 * (z.conj() * left.product).re;
        (square - self.chance[0] - z2 * self.chance[1]).max(0.0)
    }
}

/// Division of a stretch into windows.
struct Windows {
    /// Samples of a block; windows share the sums of blocks.
    block: usize,
    /// sin⁴ over the blocks of a window; their sum is 1.
    weights: Vec<f64>,
    /// The same over [`TIMES`] times.
    time_weights: [f64; TIMES],
    /// Distance from one window to the next in blocks.
    hop: usize,
    count: usize,
    /// Mean squared amplitude of white noise of variance 1.
    white: f64,
}

impl Windows {
    fn new(fit: &HarmonicFit<'_>, samples: usize) -> Option<Self> {
        let per_period = 1.0 / fit.periods_per_sample;
        let block = ((per_period / 16.0).round() as usize).max(1);
        let interval = samples as f64 / (fit.spline.functions().saturating_sub(3).max(1)) as f64;
        let length = (WINDOW * interval).max(MIN_PERIODS * per_period);
        let blocks = (length / block as f64).round() as usize;
        let hop = ((blocks as f64 / OVERLAP).round() as usize).max(1);
        let all = samples / block;
        if blocks < 8 || all < blocks {
            return None;
        }
        let bell = |k: usize, of: usize| {
            let sine = libm::sin(PI * (k as f64 + 0.5) / of as f64);
            (sine * sine) * (sine * sine)
        };
        let raw: Vec<f64> = (0..blocks).map(|b| bell(b, blocks)).collect();
        let sum: f64 = raw.iter().sum();
        let times: [f64; TIMES] = std::array::from_fn(|k| bell(k, TIMES));
        let of_times: f64 = times.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        Some(Self {
            // |2Σwx|² of white noise is 4σ²Σw², where each sample of a block carries its share.
            white: 4.0 * weights.iter().map(|w| w * w).sum::<f64>() / block as f64,
            weights,
            time_weights: times.map(|w| w / of_times),
            hop,
            count: (all - blocks) / hop + 1,
            block,
        })
    }

    fn length_s(&self, fit: &HarmonicFit<'_>) -> f64 {
        (self.weights.len() * self.block) as f64 * fit.dt_s
    }

    /// Residuals of voltage and current in a window.
    fn left(
        &self,
        window: usize,
        fit: &HarmonicFit<'_>,
        blocks: &[[Phasor; 2]],
        fitted: [&[f64]; 2],
    ) -> [Phasor; 2] {
        let from = window * self.hop;
        let mut amplitudes = [Complex::new(0.0, 0.0); 2];
        for (w, sums) in self.weights.iter().zip(&blocks[from..]) {
            for (amplitude, sum) in amplitudes.iter_mut().zip(sums) {
                *amplitude += sum * *w;
            }
        }
        let scale = 2.0 / self.block as f64;
        let start_s = (from * self.block) as f64 * fit.dt_s;
        let length_s = self.length_s(fit);
        let mut expected = [Complex::new(0.0, 0.0); 2];
        for (k, weight) in self.time_weights.iter().enumerate() {
            let share = (k as f64 + 0.5) / TIMES as f64;
            let tau_s = start_s + share * length_s - 0.5 * fit.dt_s;
            let (first, values) = fit.spline.values_at(tau_s);
            for (expected, coefficients) in expected.iter_mut().zip(fitted) {
                *expected += phasor(coefficients, fit.orders.len(), 0, first, &values) * weight;
            }
        }
        let gain = fit.gains.first().copied().unwrap_or(1.0);
        std::array::from_fn(|x| amplitudes[x] * scale - expected[x] * gain)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::CubicSpline;

    const DT_S: f64 = 1e-6;
    const SAMPLES: usize = 10_000;

    /// Excess of a fit to a modulated carrier of 45 kHz with a third harmonic and an added voltage.
    fn excess(added: impl Fn(f64) -> f64, sigma: f64) -> Excess {
        let signal = |n: usize| {
            let t = n as f64 * DT_S;
            let carrier = |h: f64| libm::cos(TAU * (h * 45e3 * t).fract() + h);
            let envelope = libm::sin(TAU * 50.0 * t);
            envelope * (200.0 * carrier(1.0) + 60.0 * carrier(3.0)) + added(t)
        };
        let v: Vec<f64> = (0..SAMPLES).map(signal).collect();
        let spline = CubicSpline::new(24, SAMPLES as f64 * DT_S);
        let fit = HarmonicFit {
            spline: &spline,
            orders: &[1, 3],
            gains: &[1.0; 2],
            periods_per_sample: 45e3 * DT_S,
            dt_s: DT_S,
            block: 1,
            centre: 0.0,
        };
        let [a, b] = fit.normal_equations(&v, &v).solve().expect("regular");
        Excess::compute(&fit, [&v, &v], [&a, &b], [sigma, sigma])
    }

    #[test]
    fn a_fit_that_holds_leaves_nothing_and_a_tone_beside_it_its_amplitude() {
        let clean = excess(|_| 0.0, 0.0);
        assert!(clean.windows.len() > 50);
        assert!(clean.windows.iter().all(|s| s.v < 1e-4), "{clean:?}");
        // 3 kHz away is beyond the splines, and within the windows.
        let tone = excess(|t| 8.0 * libm::cos(TAU * (48e3 * t).fract()), 0.5);
        let middle = tone.misfit(5e-3, 0.0.into());
        assert!((8.0..64.0).contains(&middle), "{middle:?}");
        // Both channels are the same here: with an impedance of 1 nothing is left.
        let same = tone.misfit(5e-3, 1.0.into());
        assert!(same < 1e-6, "{same}");
    }

    #[test]
    fn a_burst_shows_where_it_is() {
        let burst = |t: f64| {
            let near = (-((t - 3e-3) / 0.1e-3).powi(2)).exp();
            20.0 * near * libm::cos(TAU * (45e3 * t).fract())
        };
        let found = excess(burst, 0.5);
        assert!(
            found.misfit(3e-3, 0.0.into()) > 10.0 && found.misfit(7e-3, 0.0.into()) < 0.1,
            "{found:?}"
        );
    }
}
