//! The VI branch: v_hat(t) and i_hat(t) as switching harmonics with slowly moving phasors.
//!
//! In place of the paper's VI-MLP on eq. (2): `i_hat(t) = sum_h Re{ I_h(t) exp(j h w t) }`, each
//! phasor a cubic B-spline in slow time, and the same for v. The time derivative is analytic:
//! `di_hat/dt = sum_h Re{ (I_h' + j h w I_h) exp(j h w t) }`.

use std::f64::consts::TAU;

use ihd_spline::harmonic::{HarmonicFit, phasor};
use ihd_spline::residual::Excess;
use ihd_spline::{BasisValues, CubicSpline};
use nalgebra::Complex;

use crate::networks::signals::Signals;
use crate::waveform::NormalisedWaveform;

/// Functions of the VI branch: spline times (cos, sin) of each harmonic.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HarmonicBasis {
    pub spline: CubicSpline,
    pub harmonics: Vec<u32>,
    /// Angular switching frequency, rad/s.
    pub omega: f64,
    /// Share of each harmonic that the points contain: [`NormalisedWaveform::gain`].
    pub gains: Vec<f64>,
}

impl HarmonicBasis {
    /// Columns per spline function: a cosine and a sine per harmonic.
    pub fn width(&self) -> usize {
        2 * self.harmonics.len()
    }

    /// Number of unknowns per signal.
    pub fn len(&self) -> usize {
        self.spline.functions() * self.width()
    }

    /// Writes (cos, sin) of each harmonic at `tau_s` seconds after the first pair into `trig`.
    pub fn trigonometry(&self, tau_s: f64, trig: &mut Vec<f64>) {
        trig.clear();
        for &h in &self.harmonics {
            let (sin, cos) = (f64::from(h) * self.omega * tau_s).sin_cos();
            trig.extend([cos, sin]);
        }
    }

    /// Writes (cos, sin) of each harmonic as they appear in the points, which are means over blocks of samples.
    #[cfg(test)]
    pub fn seen(&self, tau_s: f64, trig: &mut Vec<f64>) {
        self.trigonometry(tau_s, trig);
        for (pair, gain) in trig.chunks_exact_mut(2).zip(&self.gains) {
            pair.iter_mut().for_each(|t| *t *= gain);
        }
    }
}

/// Phasors of one harmonic at one slow time, in normalised units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Phasors {
    pub v: Complex<f64>,
    pub i: Complex<f64>,
    /// `I'`, 1/s: the phasor of di/dt is `I' + j h w I`.
    pub slope: Complex<f64>,
}

/// Fitted VI branch.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HarmonicBranch {
    pub basis: HarmonicBasis,
    /// Coefficients, spline function by spline function, then (cos, sin) per harmonic.
    pub v: Vec<f64>,
    pub i: Vec<f64>,
}

impl HarmonicBranch {
    /// The phasors of `harmonics[index]` at `tau_s` seconds after the first pair.
    pub fn phasors(&self, tau_s: f64, index: usize) -> Phasors {
        let local = self.basis.spline.at(tau_s);
        let orders = self.basis.harmonics.len();
        let phasor = |x: &[f64], weights| phasor(x, orders, index, local.first, weights);
        Phasors {
            v: phasor(&self.v, &local.values),
            i: phasor(&self.i, &local.values),
            slope: phasor(&self.i, &local.slopes_per_s),
        }
    }

    /// v_hat and i_hat at the sample in the middle of each of `points` points; of `samples` only the times count.
    pub fn signals(&self, samples: &NormalisedWaveform, points: usize) -> Signals {
        let mut trig = Vec::with_capacity(self.basis.width());
        let mut signals = Signals::default();
        for n in 0..points {
            let (sample, tau_s) = samples.sample_of(n);
            self.basis.trigonometry(tau_s, &mut trig);
            let local = self.basis.spline.at(tau_s);
            signals.sample.push(sample);
            signals.v.push(self.value(&self.v, &local, &trig));
            signals.i.push(self.value(&self.i, &local, &trig));
        }
        signals
    }

    /// Mean squared errors of v_hat and i_hat over the points, point by point: L_i1 and L_i2, eqs. (5) and (6).
    #[cfg(test)]
    pub fn data_losses(&self, samples: &NormalisedWaveform) -> (f64, f64) {
        let mut trig = Vec::with_capacity(self.basis.width());
        let mut squares = (0.0, 0.0);
        for (n, (v, i)) in samples.v.iter().zip(&samples.i).enumerate() {
            let tau_s = n as f64 * samples.dt_s;
            self.basis.seen(tau_s, &mut trig);
            let local = self.basis.spline.at(tau_s);
            squares.0 += (self.value(&self.v, &local, &trig) - v).powi(2);
            squares.1 += (self.value(&self.i, &local, &trig) - i).powi(2);
        }
        let count = samples.len() as f64;
        (squares.0 / count, squares.1 / count)
    }

    /// Residual of the branch at the fundamental beyond white noise of these variances, (v, i), per point.
    pub fn excess(&self, samples: &NormalisedWaveform, white: (f64, f64)) -> Excess {
        let fit = HarmonicFit {
            spline: &self.basis.spline,
            orders: &self.basis.harmonics,
            gains: &self.basis.gains,
            periods_per_sample: self.basis.omega * samples.dt_s / TAU,
            dt_s: samples.dt_s,
            block: 1,
            centre: 0.0,
        };
        let white = [white.0.sqrt(), white.1.sqrt()];
        Excess::compute(&fit, [&samples.v, &samples.i], [&self.v, &self.i], white)
    }

    /// Amplitude of the current's fundamental, harmonic 0 of the basis, at `tau_s` seconds after the first pair, normalised.
    pub fn amplitude(&self, tau_s: f64) -> f64 {
        let (first, values) = self.basis.spline.values_at(tau_s);
        phasor(&self.i, self.basis.harmonics.len(), 0, first, &values).norm()
    }

    /// P / I_rms^2 over all harmonics at `tau_s` seconds after the first pair, normalised.
    pub fn power_ratio(&self, tau_s: f64) -> f64 {
        let (first, values) = self.basis.spline.values_at(tau_s);
        let orders = self.basis.harmonics.len();
        let (mut power, mut square) = (0.0, 0.0);
        for index in 0..orders {
            let of = |x: &[f64]| phasor(x, orders, index, first, &values);
            let (v, i) = (of(&self.v), of(&self.i));
            power += (v * i.conj()).re;
            square += i.norm_sqr();
        }
        power / square
    }

    fn value(&self, coefficients: &[f64], local: &BasisValues, trig: &[f64]) -> f64 {
        let width = self.basis.width();
        (0..4)
            .map(|m| {
                let at = (local.first + m) * width;
                let carried: f64 = coefficients[at..at + width]
                    .iter()
                    .zip(trig)
                    .map(|(c, t)| c * t)
                    .sum();
                local.values[m] * carried
            })
            .sum()
    }
}
