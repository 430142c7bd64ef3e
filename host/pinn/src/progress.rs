//! Progress of an identification, its limits, and the convergence of R and L.

use std::collections::VecDeque;
use std::fmt;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::PinnConfig;
use crate::parameters::OUTPUTS;

/// State after one optimiser step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrainingProgress {
    /// Alternation between VI branch and RL-MLP, from 1.
    pub pass: usize,
    /// Optimiser steps so far in all passes.
    pub iteration: usize,
    /// Eq. (7), with the VI branch of this pass, normalised as in the paper.
    pub loss: f64,
    /// Physics term, eq. (4), normalised.
    pub l_f: f64,
    /// Data terms, eqs. (5) and (6) together, normalised.
    pub l_i: f64,
    /// Mean relative errors of R and L at the slow times in %; `None` if the truth is unknown.
    pub mre_pct: Option<(f64, f64)>,
    /// Mean relative change of R and L (the larger) over the last few steps, 1e-2 being 1 %; infinite at first.
    pub change: f64,
    /// Time since the call, including earlier runs of a continued training, s.
    pub elapsed_s: f64,
}

/// Reason why the optimiser stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// R and L have converged.
    Settled,
    /// No damping gives a smaller loss: a minimum to working precision.
    NoDescent,
    /// The law of `at_once` holds and was solved in closed form; nothing was trained.
    ClosedForm,
    /// The configured number of steps is reached.
    IterationLimit,
    /// The configured time is reached.
    TimeLimit,
    /// The loss became NaN or infinite; the result holds the last good parameters.
    RolledBack,
}

impl StopReason {
    /// Returns `true` if the parameters are a minimum and not just the best so far.
    #[must_use]
    pub fn is_converged(self) -> bool {
        matches!(self, Self::Settled | Self::NoDescent | Self::ClosedForm)
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Settled => "R and L settled",
            Self::NoDescent => "no further descent",
            Self::ClosedForm => "learned law, in closed form",
            Self::IterationLimit => "iteration limit",
            Self::TimeLimit => "time limit",
            Self::RolledBack => "loss not finite, rolled back to the last good parameters",
        })
    }
}

/// Budget, history and the caller's progress report, shared by the optimisers.
pub(crate) struct Log<'a> {
    pub history: Vec<TrainingProgress>,
    pub iteration: usize,
    pub pass: usize,
    /// `w_i (L_i1 + L_i2)` of the VI branch of this pass.
    pub data_loss: f64,
    /// Part of `w_f L_f` that the network cannot change in this pass.
    pub floor: f64,
    /// R / r_scale and L / l_scale of the truth, alternating; `None` if it is unknown.
    pub truth: Option<Vec<f64>>,
    w_f: f64,
    w_i: f64,
    deterministic: bool,
    max_iterations: usize,
    started: Instant,
    /// Time of earlier runs of a continued training, s.
    earlier_s: f64,
    time_limit: Duration,
    report: &'a mut dyn FnMut(&TrainingProgress),
}

impl<'a> Log<'a> {
    pub fn start(config: &PinnConfig, report: &'a mut dyn FnMut(&TrainingProgress)) -> Self {
        Self {
            history: Vec::new(),
            iteration: 0,
            pass: 0,
            data_loss: 0.0,
            floor: 0.0,
            truth: None,
            w_f: config.w_f,
            w_i: config.w_i,
            deterministic: config.deterministic,
            max_iterations: config.max_iterations,
            started: Instant::now(),
            earlier_s: 0.0,
            time_limit: Duration::try_from_secs_f64(config.time_limit_s).unwrap_or(Duration::MAX),
            report,
        }
    }

    /// Continues after these steps of an earlier run.
    pub fn resume(&mut self, history: &mut Vec<TrainingProgress>) {
        self.iteration = history.len();
        self.history = std::mem::take(history);
        self.earlier_s = self.history.last().map_or(0.0, |p| p.elapsed_s);
    }

    /// Time since the start, including earlier runs, s.
    pub fn elapsed_s(&self) -> f64 {
        self.earlier_s + self.started.elapsed().as_secs_f64()
    }

    /// Counts a step and reports it; `squares` is the sum of squared residuals, `outputs` are those of the
    /// network at the slow times.
    pub fn record(&mut self, squares: f64, change: f64, outputs: &[f64]) {
        let physics = squares + self.floor;
        let l_i = self.data_loss / self.w_i;
        self.record_terms(physics / self.w_f, l_i, change, outputs);
    }

    /// Counts a step and reports it, given the terms of the loss.
    pub fn record_terms(&mut self, l_f: f64, l_i: f64, change: f64, outputs: &[f64]) {
        self.iteration += 1;
        let now = TrainingProgress {
            pass: self.pass,
            iteration: self.iteration,
            loss: self.w_f * l_f + self.w_i * l_i,
            l_f,
            l_i,
            mre_pct: self.truth.as_ref().map(|truth| {
                let [r, l] = relative_changes(outputs, truth);
                (100.0 * r, 100.0 * l)
            }),
            change,
            elapsed_s: self.elapsed_s(),
        };
        self.history.push(now);
        (self.report)(&now);
    }

    /// Limit that is reached; `None` if there is none.
    pub fn exhausted(&self) -> Option<StopReason> {
        if self.iteration >= self.max_iterations {
            Some(StopReason::IterationLimit)
        } else if !self.deterministic && self.started.elapsed() >= self.time_limit {
            Some(StopReason::TimeLimit)
        } else {
            None
        }
    }
}

/// Convergence test of R and L over the last few steps. One small step proves nothing, because strong damping makes
/// steps small; several together do.
pub(crate) struct Settling {
    steps: usize,
    past: VecDeque<Vec<f64>>,
}

impl Settling {
    pub fn over(steps: usize) -> Self {
        Self {
            steps,
            past: VecDeque::with_capacity(steps + 1),
        }
    }

    /// Creates the test with earlier outputs, oldest first.
    pub fn from_past(steps: usize, past: Vec<Vec<f64>>) -> Self {
        Self {
            steps,
            past: past.into(),
        }
    }

    /// Outputs so far, oldest first.
    pub fn past(&self) -> Vec<Vec<f64>> {
        self.past.iter().cloned().collect()
    }

    /// Adds outputs; returns their mean relative change since `steps` steps ago, infinite before there were so many.
    pub fn change(&mut self, outputs: Vec<f64>) -> f64 {
        let change = if self.past.len() < self.steps {
            f64::INFINITY
        } else {
            self.past
                .pop_front()
                .map_or(f64::INFINITY, |old| relative_change(&old, &outputs))
        };
        self.past.push_back(outputs);
        change
    }
}

/// Mean relative change of R or of L, the larger; outputs alternate R, L.
pub(crate) fn relative_change(old: &[f64], new: &[f64]) -> f64 {
    let [r, l] = relative_changes(old, new);
    f64::max(r, l)
}

/// Mean relative changes of R and of L.
fn relative_changes(old: &[f64], new: &[f64]) -> [f64; OUTPUTS] {
    let mut sums = [0.0; OUTPUTS];
    for (at, (a, b)) in old.iter().zip(new).enumerate() {
        sums[at % OUTPUTS] += ((b - a) / b).abs();
    }
    let rows = (new.len() / OUTPUTS).max(1) as f64;
    sums.map(|sum| sum / rows)
}
