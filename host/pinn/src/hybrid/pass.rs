//! One pass: with the VI branch held, the RL-MLP minimises
//!
//!   |e(θ)|² + (σ²/w²) |θ − c|²,
//!
//! e being the condensed physics residuals with |e|² = w_f L_f less a floor (eq. (4), [`SlowPhysics`]), σ² their
//! variance under the samples' white noise, w the width expected of the weights θ (`weight_width`) and c the
//! constant network that fits best.

use super::inputs::Inputs;
use crate::derivatives::Derivatives;
use crate::harmonic_branch::HarmonicBranch;
use crate::levenberg_marquardt::{Evaluation, LeastSquares, Prior, minimise};
use crate::loss::{SlowPhysics, slow_times_s};
use crate::noise::{noise_variance, white_noise};
use crate::optimiser::Descent;
use crate::parameters::Parameters;
use crate::progress::{Log, StopReason, relative_change};
use crate::slow_model::SlowModel;
use crate::vi_system::Impedance;
use crate::{Optimiser, PinnError, adam};

/// Convergence limit of a pass: the share of the standard deviation that noise would leave for a constant load. Smaller changes
/// of R and L are noise.
const SHARE_OF_NOISE: f64 = 0.4;

/// Problem of the RL-MLP with one VI branch.
pub(super) struct Pass<'a> {
    pub inputs: &'a Inputs<'a>,
    /// Network at the start of the pass.
    start: Parameters,
    pub model: SlowModel,
    /// Variance of the white noise of the normalised points, (v, i).
    pub white: (f64, f64),
    pub prior: Prior,
    /// Variance of one physics residual.
    pub noise: f64,
    /// L_i1 and L_i2 of the branch, eqs. (5) and (6).
    pub data_losses: (f64, f64),
    /// Part of `w_f L_f` that the network cannot change.
    pub floor: f64,
    /// Relative change of R and L below which they have converged; 0 never.
    pub tolerance: f64,
    /// Set if the tolerance is above the noise: a branch fitted to the data alone is then as good as one fitted with R and L.
    pub is_quiet: bool,
    tau_s: Vec<f64>,
}

impl<'a> Pass<'a> {
    /// Creates a pass from the network of the last one, or from an outline without layers, which gets initial weights.
    ///
    /// # Errors
    /// [`PinnError::Backend`] if the configured backend has no device here.
    pub fn new(
        inputs: &'a Inputs<'a>,
        branch: &HarmonicBranch,
        network: Parameters,
    ) -> Result<Self, PinnError> {
        let (samples, config) = (inputs.samples, inputs.config);
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let physics =
            SlowPhysics::condense(branch, samples, &network, &inputs.laws, config.w_f, times);
        let constant = physics.best_constant();
        let start = if network.layers.is_empty() {
            network.initial(&config.hidden_layers, config.seed, constant)
        } else {
            network
        };
        let data_losses = inputs.system.losses(branch);
        let white = white_noise(samples, branch, data_losses, config.noise);
        let [r, l] = constant;
        let typical = [r * start.r_scale_ohm, l * start.l_scale_h];
        let noise = noise_variance(samples, white, config.w_f, typical);
        let by_noise = SHARE_OF_NOISE * physics.relative_sigma(constant, noise);
        Ok(Self {
            model: SlowModel::new(&physics, samples, &start, config)?,
            prior: Prior {
                strength: match config.weight_width {
                    0.0 => 0.0,
                    width => noise / (width * width),
                },
                centre: start.constant(constant).flat(),
            },
            tolerance: match config.tolerance {
                0.0 => 0.0,
                specified => specified.max(by_noise),
            },
            is_quiet: by_noise < config.tolerance,
            floor: physics.floor,
            tau_s: physics.tau_s,
            white,
            inputs,
            start,
            noise,
            data_losses,
        })
    }

    /// Trains the network until R and L have converged, or a limit of the log is reached.
    pub fn train(&self, log: &mut Log<'_>) -> Result<Descent, PinnError> {
        let config = self.inputs.config;
        log.data_loss = config.w_i * (self.data_losses.0 + self.data_losses.1);
        log.floor = self.floor;
        let start = self.start.clone();
        match config.optimiser {
            Optimiser::LevenbergMarquardt => self.levenberg_marquardt(log),
            Optimiser::Adam => {
                let rate = config.learning_rate;
                adam::descend(&self.model, start, rate, self.tolerance, log)
            }
        }
    }

    fn levenberg_marquardt(&self, log: &mut Log<'_>) -> Result<Descent, PinnError> {
        let flat = self.start.flat();
        let minimum = minimise(self, flat, &self.prior, self.tolerance, log)?;
        if minimum.stopped == StopReason::RolledBack {
            // Only a warm start can fail so early: the constant network is the last good one.
            return Ok(Descent {
                squares: self.evaluate(&self.prior.centre)?.squares(),
                parameters: self.start.with_flat(&self.prior.centre),
                stopped: minimum.stopped,
            });
        }
        Ok(Descent {
            parameters: self.start.with_flat(&minimum.theta),
            squares: minimum.squares,
            stopped: minimum.stopped,
        })
    }

    /// Relative change of R or L from the start of the pass to `parameters`, the larger.
    pub fn change_to(&self, parameters: &Parameters) -> f64 {
        relative_change(&self.r_l(&self.start), &self.r_l(parameters))
    }

    /// R (ohm) and L (H) alternating, at the slow times.
    fn r_l(&self, parameters: &Parameters) -> Vec<f64> {
        let at = |tau: &f64| parameters.r_l_at(self.inputs.samples.t0_s + tau);
        let both = self.tau_s.iter().map(at);
        both.flat_map(|(r, l)| [r, l]).collect()
    }

    /// R and L of `parameters` at the slow times, normalised for the VI branch.
    pub fn impedances(&self, parameters: &Parameters) -> Vec<Impedance> {
        let samples = self.inputs.samples;
        let scale = samples.impedance_scale();
        let at = |tau_s: &f64| {
            let (r, l) = parameters.r_l_at(samples.t0_s + tau_s);
            Impedance {
                tau_s: *tau_s,
                r: r * scale,
                l: l * scale,
            }
        };
        self.tau_s.iter().map(at).collect()
    }
}

impl LeastSquares for Pass<'_> {
    type Error = PinnError;

    fn evaluate(&self, theta: &[f64]) -> Result<Evaluation, PinnError> {
        self.model.evaluate(&self.start.with_flat(theta))
    }

    fn jacobian(&self, theta: &[f64]) -> Result<Derivatives, PinnError> {
        self.model.jacobian(&self.start.with_flat(theta))
    }
}
