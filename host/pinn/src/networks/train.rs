//! Minimises the paper's eq. (7) over the weights of both networks by Adam, as the paper does, with limits,
//! rollback and checkpoints.

use std::path::Path;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::burn_kernel::Burn;
use super::checkpoint::{Checkpoint, State};
use super::collocation::{Collocation, Impedances};
use super::fused::Fused;
use super::kernel::{Kernel, Problem, Terms, Weights};
use super::shape::Shape;
use crate::adam::Adam;
use crate::loss::slow_times_s;
use crate::parameters::Parameters;
use crate::progress::{Log, Settling, StopReason};
use crate::result::assemble_networks;
use crate::waveform::NormalisedWaveform;
use crate::{Identification, LossTerms, PinnConfig, PinnError, ViMlp};

/// Epochs between two checks of R and L.
const CHECK_EVERY: usize = 10;
/// Checks over which the change of R and L is compared with the tolerance: 200 epochs.
const SETTLING_CHECKS: usize = 20;
/// Epochs between two checkpoints.
const CHECKPOINT_EVERY: usize = 100;
/// Most rollbacks of a training.
const MAX_ROLLBACKS: u32 = 5;
/// Adam's epsilon: PyTorch's default, which the paper used.
const EPSILON: f64 = 1e-8;
/// Share by which one balancing step moves the physics term's weight towards its goal (Wang et al. 2021).
const BALANCE_STEP: f64 = 0.1;

/// Identifies R(t) and L(t) with the paper's two networks; continues from `checkpoint` if it exists, and keeps it up to
/// date.
pub(crate) fn identify(
    samples: &NormalisedWaveform,
    config: &PinnConfig,
    vi: &ViMlp,
    checkpoint: Option<&Path>,
    mut log: Log<'_>,
) -> Result<Identification, PinnError> {
    let points = Collocation::new(samples, vi, &config.embedding, config.seed);
    let shape = Shape::new(
        (vi.width(), &vi.hidden_layers),
        (config.embedding.width(), &config.hidden_layers),
    );
    let problem = Problem {
        shape: &shape,
        points: &points,
        impedances: impedances(samples, config),
    };
    let file = Checkpoint::new(checkpoint, samples, config, vi);
    let mut state = file.load(first_state(&shape, config)?)?;
    log.resume(&mut state.history);
    log.pass = 1;
    let mut training = Training {
        settling: Settling::from_past(SETTLING_CHECKS, std::mem::take(&mut state.past)),
        tau_s: slow_times_s(samples.duration_s(), config.slow_points),
        samples,
        config,
        vi,
        problem,
        kernel: match config.backend.device()? {
            None => Box::new(Fused::new(&shape)),
            Some(device) => Box::new(Burn::new(config.backend, device)),
        },
        gradient: vec![0.0; shape.len],
        state,
    };
    let stopped = training.run(&file, &mut log)?;
    training.finish(stopped, log)
}

/// R and ω L of outputs 1, normalised.
fn impedances(samples: &NormalisedWaveform, config: &PinnConfig) -> Impedances {
    let scale = samples.impedance_scale();
    Impedances {
        r: (config.r_scale_ohm * scale) as f32,
        x: (config.l_scale_h * samples.omega * scale) as f32,
    }
}

/// Initial weights from the seed, or those of the warm start.
fn first_state(shape: &Shape, config: &PinnConfig) -> Result<State, PinnError> {
    let mut theta = shape.xavier(config.seed);
    if let Some(start) = &config.start {
        let fits = Shape::insert(&shape.rl, &start.layers, &mut theta)
            && (start.vi_layers.is_empty()
                || Shape::insert(&shape.vi, &start.vi_layers, &mut theta));
        if !fits {
            return Err(PinnError::WarmStart {
                given: format!("{:?}", start.hidden_layers()),
                configured: format!("{:?}", config.hidden_layers),
            });
        }
    }
    let theta: Vec<f64> = theta.iter().map(|x| f64::from(*x)).collect();
    Ok(State {
        epoch: 0,
        adam: Adam::new(theta.len(), EPSILON),
        best: theta.clone(),
        best_loss: f64::INFINITY,
        rate_factor: 1.0,
        rollbacks: 0,
        w_f: config.w_f,
        past: Vec::new(),
        history: Vec::new(),
        theta,
    })
}

/// Running training.
struct Training<'a> {
    samples: &'a NormalisedWaveform,
    config: &'a PinnConfig,
    vi: &'a ViMlp,
    problem: Problem<'a>,
    kernel: Box<dyn Kernel>,
    tau_s: Vec<f64>,
    settling: Settling,
    gradient: Vec<f32>,
    state: State,
}

impl Training<'_> {
    /// Runs epochs until one gives a reason to stop, or a limit of the log is reached; writes the checkpoint at the end, too.
    fn run(&mut self, file: &Checkpoint<'_>, log: &mut Log<'_>) -> Result<StopReason, PinnError> {
        let stopped = loop {
            if let Some(limit) = log.exhausted() {
                break limit;
            }
            if let Some(stopped) = self.epoch(log)? {
                break stopped;
            }
            if self.state.epoch.is_multiple_of(CHECKPOINT_EVERY) {
                file.save(|| self.snapshot(log))?;
            }
        };
        file.save(|| self.snapshot(log))?;
        Ok(stopped)
    }

    /// Runs one epoch over all batches; returns the reason to stop if there is one.
    fn epoch(&mut self, log: &mut Log<'_>) -> Result<Option<StopReason>, PinnError> {
        let before = (self.state.theta.clone(), self.state.adam.clone());
        self.balance()?;
        let terms = self.all_batches()?;
        let loss = terms.total(self.weights());
        let sound = loss.is_finite() && self.state.theta.iter().all(|x| x.is_finite());
        if !sound {
            (self.state.theta, self.state.adam) = before;
            self.state.rollbacks += 1;
            self.state.rate_factor *= 0.5;
            let given_up = self.state.rollbacks > MAX_ROLLBACKS;
            return Ok(given_up.then_some(StopReason::RolledBack));
        }
        if loss < self.state.best_loss {
            // This is the loss before the step.
            self.state.best_loss = loss;
            self.state.best = before.0;
        }
        self.state.epoch += 1;
        let outputs = self.outputs(&self.state.theta);
        let mut change = log.history.last().map_or(f64::INFINITY, |p| p.change);
        if self.state.epoch.is_multiple_of(CHECK_EVERY) {
            change = self.settling.change(outputs.clone());
        }
        log.record_terms(terms.l_f, terms.l_i1 + terms.l_i2, change, &outputs);
        Ok((change < self.config.tolerance).then_some(StopReason::Settled))
    }

    /// Runs a gradient step per batch; the terms are means of those before each step.
    fn all_batches(&mut self) -> Result<Terms, PinnError> {
        let count = self.problem.points.len();
        let size = self.vi.minibatch.unwrap_or(count).clamp(1, count.max(1));
        let mut starts: Vec<usize> = (0..count).step_by(size).collect();
        if starts.len() > 1 {
            // The seed contains the epoch, so that a continued training has the same order.
            let seed = self.config.seed ^ (self.state.epoch as u64).rotate_left(32);
            starts.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        }
        let mut sum = Terms::default();
        let rate = self.learning_rate();
        for start in starts {
            let batch = start..(start + size).min(count);
            let share = batch.len() as f64 / count as f64;
            let terms = self.gradient_at(batch, self.weights())?;
            sum.l_f += share * terms.l_f;
            sum.l_i1 += share * terms.l_i1;
            sum.l_i2 += share * terms.l_i2;
            let gradient = self.gradient.iter().map(|g| f64::from(*g));
            self.state.adam.step(rate, &mut self.state.theta, gradient);
        }
        Ok(sum)
    }

    fn gradient_at(
        &mut self,
        batch: std::ops::Range<usize>,
        weights: Weights,
    ) -> Result<Terms, PinnError> {
        let theta = single(&self.state.theta);
        self.kernel
            .loss(&self.problem, &theta, batch, weights, &mut self.gradient)
    }

    /// Learning rate, which falls geometrically from the first epoch to the last.
    fn learning_rate(&self) -> f64 {
        let progress = self.state.epoch as f64 / self.config.max_iterations as f64;
        self.config.learning_rate * self.state.rate_factor * self.vi.last_rate.powf(progress)
    }

    fn weights(&self) -> Weights {
        Weights {
            w_f: self.state.w_f as f32,
            w_i: self.config.w_i as f32,
        }
    }

    /// Moves w_f towards the ratio of the lengths of the data terms' gradient and the physics term's
    /// (after Wang, Teng and Perdikaris 2021). The least loss counts from there on.
    fn balance(&mut self) -> Result<(), PinnError> {
        let every = self.vi.balance_every;
        if every == 0 || self.state.epoch == 0 || !self.state.epoch.is_multiple_of(every) {
            return Ok(());
        }
        let all = 0..self.problem.points.len();
        let w_i = self.config.w_i as f32;
        let mut length = |weights| -> Result<f64, PinnError> {
            self.gradient_at(all.clone(), weights)?;
            let squares = self.gradient.iter().map(|g| f64::from(*g).powi(2));
            Ok(squares.sum::<f64>().sqrt())
        };
        let physics = length(Weights { w_f: 1.0, w_i: 0.0 })?;
        let data = length(Weights { w_f: 0.0, w_i })?;
        let goal = data / physics;
        if goal.is_finite() {
            self.state.w_f += BALANCE_STEP * (goal - self.state.w_f);
            // Losses of different weights do not compare.
            self.state.best_loss = f64::INFINITY;
        }
        Ok(())
    }

    /// R / r_scale and L / l_scale at the slow times, alternating.
    fn outputs(&self, theta: &[f64]) -> Vec<f64> {
        let parameters = self.parameters(theta);
        let features = |tau: &f64| {
            let t_s = self.samples.t0_s + tau;
            let mains = self.samples.f_mains_hz;
            self.config.embedding.features(t_s, mains)
        };
        let outputs = self.tau_s.iter().map(|t| parameters.outputs(&features(t)));
        outputs.collect::<Vec<_>>().concat()
    }

    fn parameters(&self, theta: &[f64]) -> Parameters {
        let theta = single(theta);
        Parameters {
            embedding: self.config.embedding,
            f_mains_hz: self.samples.f_mains_hz,
            r_scale_ohm: self.config.r_scale_ohm,
            l_scale_h: self.config.l_scale_h,
            layers: Shape::extract(&self.problem.shape.rl, &theta),
            vi_layers: Shape::extract(&self.problem.shape.vi, &theta),
            inputs: None,
        }
    }

    fn snapshot(&self, log: &Log<'_>) -> State {
        State {
            past: self.settling.past(),
            history: log.history.clone(),
            ..self.state.clone()
        }
    }

    /// Result of the training: the parameters of the least loss. Its total is that of the configured weights, so that members of an
    /// ensemble, each of which balances for itself, compare.
    fn finish(mut self, stopped: StopReason, log: Log<'_>) -> Result<Identification, PinnError> {
        self.state.theta = self.state.best.clone();
        let all = 0..self.problem.points.len();
        let terms = self.gradient_at(all, self.weights())?;
        let theta = single(&self.state.theta);
        let (v, i) = self.kernel.signals(&self.problem, &theta)?;
        let losses = LossTerms {
            l_f: terms.l_f,
            l_i1: terms.l_i1,
            l_i2: terms.l_i2,
            total: terms.total(Weights {
                w_f: self.config.w_f as f32,
                ..self.weights()
            }),
        };
        let parameters = self.parameters(&self.state.theta);
        let signals = super::in_order(&self.problem.points.sample, &v, &i);
        Ok(assemble_networks(
            self.samples,
            self.config,
            parameters,
            signals,
            losses,
            stopped,
            log,
        ))
    }
}

fn single(theta: &[f64]) -> Vec<f32> {
    theta.iter().map(|x| *x as f32).collect()
}
