//! Result of an identification: R(t), L(t), the terms of the paper's eq. (7), NMSE, P/I_rms².

use std::f64::consts::TAU;

use ihd_signal::interpolation::linear;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use crate::harmonic_branch::HarmonicBranch;
use crate::networks::signals::Signals;
use crate::progress::Log;
use crate::waveform::NormalisedWaveform;
use crate::{Parameters, PinnConfig, StopReason, TrainingProgress};

/// Terms of the paper's loss at the end, in the paper's normalised units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LossTerms {
    /// Physics residual, eq. (4), over the configured harmonics.
    pub l_f: f64,
    /// Voltage misfit, eq. (5).
    pub l_i1: f64,
    /// Current misfit, eq. (6).
    pub l_i2: f64,
    /// Eq. (7): `w_f l_f + w_i (l_i1 + l_i2)` at the configured weights, whatever loss balancing made of them.
    pub total: f64,
}

/// Voltage and current of the VI branch.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ViWaveforms {
    /// Indices of the window's samples at which they are given, ascending.
    pub sample: Vec<usize>,
    /// Voltage, V.
    pub v_volt: Vec<f64>,
    /// Current, A.
    pub i_ampere: Vec<f64>,
}

/// Source of [`ViWaveforms`], which are computed on request: they are seldom needed, and the harmonic branch's take as long as
/// its fit.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reconstruction(Source);

#[derive(Debug, Clone, PartialEq)]
enum Source {
    Known(ViWaveforms),
    Branch {
        branch: Box<HarmonicBranch>,
        /// Window without its points, of which only the number is kept.
        samples: Box<NormalisedWaveform>,
        points: usize,
    },
}

impl Default for Source {
    fn default() -> Self {
        Self::Known(ViWaveforms::default())
    }
}

impl Reconstruction {
    /// Source from the harmonic branch.
    pub(crate) fn of_branch(samples: &NormalisedWaveform, branch: &HarmonicBranch) -> Self {
        Self(Source::Branch {
            branch: Box::new(branch.clone()),
            samples: Box::new(samples.outline()),
            points: samples.len(),
        })
    }

    /// Voltage and current; empty if the result was read from a file.
    #[must_use]
    pub fn waveforms(&self) -> ViWaveforms {
        match &self.0 {
            Source::Known(waveforms) => waveforms.clone(),
            Source::Branch {
                branch,
                samples,
                points,
            } => waveforms(samples, branch.signals(samples, *points)),
        }
    }
}

/// R(t) and L(t) of one window, with the details of the training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identification {
    /// Times after the mains zero crossing, evenly spaced from the first to the last pair, s.
    pub t_s: Vec<f64>,
    /// R at those times, ohm.
    pub r_ohm: Vec<f64>,
    /// L at those times, H.
    pub l_h: Vec<f64>,
    /// Standard deviation of R at those times, ohm: Laplace's approximation, which contains noise and the residual of the waveforms
    /// beyond noise, and the spread of an ensemble. A VI-MLP has the spread alone; empty if there is neither.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L at those times, H; empty if `r_sigma_ohm` is.
    pub l_sigma_h: Vec<f64>,
    /// Residual χ² at the fundamental against white noise at those times, by which σ of Laplace's approximation was raised; empty
    /// without one.
    #[serde(default)]
    pub chi2: Vec<f64>,
    /// Order n of Z(s) = s L_0 + K s^n of the result: [`crate::PinnConfig::impedance_order`].
    pub impedance_order: f64,
    /// P / I_rms^2 at those times, ohm, from the VI branch's signals with all their harmonics.
    pub r_power_ohm: Vec<f64>,
    /// Amplitude of the current's fundamental at those times, A: the axis of an RL lookup.
    pub i_amplitude_a: Vec<f64>,
    /// Loss at the end.
    pub losses: LossTerms,
    /// One entry per accepted optimiser step.
    pub history: Vec<TrainingProgress>,
    /// Optimiser steps in all passes.
    pub iterations: usize,
    /// Alternations between VI branch and RL-MLP.
    pub passes: usize,
    /// Reason why the optimiser stopped.
    pub stopped_because: StopReason,
    /// Wall-clock time of the call, and of earlier runs if it continued from a checkpoint, s.
    pub elapsed_s: f64,
    /// 100 * sum((v_hat - v)^2) / sum(v^2) over the fitted points, %.
    pub nmse_v_pct: f64,
    /// 100 * sum((i_hat - i)^2) / sum(i^2) over the fitted points, %.
    pub nmse_i_pct: f64,
    /// Source of v and i of the VI branch; not serialised.
    #[serde(skip)]
    pub reconstruction: Reconstruction,
    /// Trained RL-MLP; [`crate::PinnConfig::start`] takes it for a warm start.
    pub parameters: Parameters,
}

impl Identification {
    /// R at `t_s` seconds after the mains zero crossing, ohm.
    #[must_use]
    pub fn r_at(&self, t_s: f64) -> f64 {
        linear(&self.t_s, &self.r_ohm, t_s).unwrap_or(f64::NAN)
    }

    /// L at `t_s` seconds after the mains zero crossing, H.
    #[must_use]
    pub fn l_at(&self, t_s: f64) -> f64 {
        linear(&self.t_s, &self.l_h, t_s).unwrap_or(f64::NAN)
    }

    /// Means of sigma/R and sigma/L over the window in %, weighted with the squared current, which determines the power. `None` if
    /// sigma is unknown.
    #[must_use]
    pub fn relative_sigma_pct(&self) -> Option<(f64, f64)> {
        let weights: Vec<f64> = self.i_amplitude_a.iter().map(|i| i * i).collect();
        let mean = |sigma: &[f64], value: &[f64]| {
            let terms = weights.iter().zip(sigma.iter().zip(value));
            let sum: f64 = terms.map(|(w, (s, x))| w * s / x).sum();
            100.0 * sum / weights.iter().sum::<f64>()
        };
        (!self.r_sigma_ohm.is_empty()).then(|| {
            (
                mean(&self.r_sigma_ohm, &self.r_ohm),
                mean(&self.l_sigma_h, &self.l_h),
            )
        })
    }
}

/// The signals in volt and ampere.
fn waveforms(samples: &NormalisedWaveform, signals: Signals) -> ViWaveforms {
    let scaled = |x: &[f64], unit: f64| x.iter().map(|x| x * unit).collect();
    ViWaveforms {
        v_volt: scaled(&signals.v, samples.v_max_volt),
        i_ampere: scaled(&signals.i, samples.i_max_ampere),
        sample: signals.sample,
    }
}

/// Results per slow time: at the ends R bends within 0.1 ms.
const RESULTS_PER_TIME: usize = 4;

/// Times of the results after the first pair, s.
pub(crate) fn result_times_s(samples: &NormalisedWaveform, config: &PinnConfig) -> Vec<f64> {
    let count = RESULTS_PER_TIME * config.slow_points;
    let last = (count - 1) as f64;
    (0..count)
        .map(|k| k as f64 / last * samples.duration_s())
        .collect()
}

/// 100 * sum((x_hat - x)^2) / sum(x^2), `l_i` being the mean of the squared differences, %.
pub(crate) fn nmse_pct(l_i: f64, x: &[f64]) -> f64 {
    100.0 * l_i * x.len() as f64 / x.iter().map(|x| x * x).sum::<f64>()
}

/// Result of a training with the paper's VI-MLP.
pub(crate) fn assemble_networks(
    samples: &NormalisedWaveform,
    config: &PinnConfig,
    parameters: Parameters,
    signals: Signals,
    losses: LossTerms,
    stopped: StopReason,
    log: Log<'_>,
) -> Identification {
    let tau_s = result_times_s(samples, config);
    let (r_ohm, l_h) = tau_s
        .iter()
        .map(|tau| parameters.r_l_at(samples.t0_s + tau))
        .unzip();
    let (mut i_amplitude_a, mut r_power_ohm) = (Vec::new(), Vec::new());
    for tau in &tau_s {
        let around = LocalMeans::compute(samples, &signals, *tau);
        i_amplitude_a.push(around.amplitude * samples.i_max_ampere);
        r_power_ohm.push(around.power_ratio / samples.impedance_scale());
    }
    let at_points = |x: &[f64]| -> Vec<f64> { signals.sample.iter().map(|n| x[*n]).collect() };
    Identification {
        impedance_order: 0.0,
        nmse_v_pct: nmse_pct(losses.l_i1, &at_points(&samples.v)),
        nmse_i_pct: nmse_pct(losses.l_i2, &at_points(&samples.i)),
        reconstruction: Reconstruction(Source::Known(waveforms(samples, signals))),
        t_s: tau_s.iter().map(|tau| samples.t0_s + tau).collect(),
        r_ohm,
        l_h,
        r_sigma_ohm: Vec::new(),
        l_sigma_h: Vec::new(),
        chi2: Vec::new(),
        r_power_ohm,
        i_amplitude_a,
        losses,
        iterations: log.iteration,
        passes: log.pass,
        stopped_because: stopped,
        elapsed_s: log.elapsed_s(),
        history: log.history,
        parameters,
    }
}

/// Switching periods on either side of a time that [`LocalMeans`] covers.
const PERIODS: f64 = 2.0;

/// Current and power of the signals around one time.
struct LocalMeans {
    /// Amplitude of the current's fundamental, normalised.
    amplitude: f64,
    /// Mean of v i over mean of i^2, normalised.
    power_ratio: f64,
}

impl LocalMeans {
    fn compute(samples: &NormalisedWaveform, signals: &Signals, tau_s: f64) -> Self {
        let reach_s = PERIODS * TAU / samples.omega;
        let time = |n: &usize| *n as f64 * samples.dt_s;
        // At the ends a stretch of the same length lies on one side.
        let end_s = signals.sample.last().map_or(0.0, time);
        let from_s = (tau_s - reach_s).min(end_s - 2.0 * reach_s).max(0.0);
        let first = signals.sample.partition_point(|n| time(n) < from_s);
        let last = signals
            .sample
            .partition_point(|n| time(n) < from_s + 2.0 * reach_s);
        let (mut sum, mut power, mut square) = (Complex::new(0.0, 0.0), 0.0, 0.0);
        for at in first..last {
            let (v, i) = (signals.v[at], signals.i[at]);
            sum += Complex::from_polar(i, -samples.omega * time(&signals.sample[at]));
            power += v * i;
            square += i * i;
        }
        Self {
            amplitude: 2.0 * sum.norm() / (last - first).max(1) as f64,
            power_ratio: power / square,
        }
    }
}
