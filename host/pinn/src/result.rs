//! What an identification hands back.

use serde::{Deserialize, Serialize};

use crate::{Parameters, Progress, StoppedBecause};

/// The terms of the paper's loss at the end, in the paper's normalised units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Losses {
    /// Physics residual, eq. (4), over the configured harmonics.
    pub l_f: f64,
    /// Voltage misfit, eq. (5).
    pub l_i1: f64,
    /// Current misfit, eq. (6).
    pub l_i2: f64,
    /// Eq. (7): `w_f l_f + w_i (l_i1 + l_i2)`.
    pub total: f64,
}

/// R(t) and L(t) of one window, and how they came about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identified {
    /// Times after the mains zero crossing, evenly spaced from the first to the last pair, s.
    pub t_s: Vec<f64>,
    /// R at those times, ohm.
    pub r_ohm: Vec<f64>,
    /// L at those times, H.
    pub l_h: Vec<f64>,
    /// Amplitude of the current's fundamental at those times, A: the axis of an RL lookup.
    pub i_amplitude_a: Vec<f64>,
    /// The loss at the end.
    pub losses: Losses,
    /// One entry per accepted optimiser step.
    pub history: Vec<Progress>,
    /// Optimiser steps in all passes.
    pub iterations: usize,
    /// Alternations between VI branch and RL-MLP.
    pub passes: usize,
    /// Why the optimiser stopped.
    pub stopped_because: StoppedBecause,
    /// Wall-clock time of the call, s.
    pub elapsed_s: f64,
    /// 100 * sum((v_hat - v)^2) / sum(v^2) over the samples, %.
    pub nmse_v_pct: f64,
    /// The same of the current, %.
    pub nmse_i_pct: f64,
    /// The trained RL-MLP: put it into [`crate::Config::start`] for a warm start.
    pub parameters: Parameters,
}

impl Identified {
    /// R at `t_s` seconds after the mains zero crossing, ohm.
    #[must_use]
    pub fn r_at(&self, t_s: f64) -> f64 {
        self.parameters.r_l_at(t_s).0
    }

    /// L at `t_s` seconds after the mains zero crossing, H.
    #[must_use]
    pub fn l_at(&self, t_s: f64) -> f64 {
        self.parameters.r_l_at(t_s).1
    }
}
