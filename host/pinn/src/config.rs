//! Settings of an identification and their ranges.

mod ranges;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{Backend, ImpedanceOrder, Parameters, PinnError, SlowEmbedding, SlowInputs, ViMlp};

/// Optimiser of the RL-MLP on the physics term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Optimiser {
    /// Damped Gauss-Newton on all slow times at once.
    #[default]
    LevenbergMarquardt,
    /// Adam on the gradient from burn's reverse mode, as in the paper, for comparison.
    Adam,
}

impl fmt::Display for Optimiser {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::LevenbergMarquardt => "levenberg-marquardt",
            Self::Adam => "adam",
        })
    }
}

impl FromStr for Optimiser {
    type Err = PinnError;

    /// Reads `levenberg-marquardt` or `adam`.
    ///
    /// # Errors
    /// [`PinnError::UnknownName`] for anything else.
    fn from_str(name: &str) -> Result<Self, PinnError> {
        match name {
            "levenberg-marquardt" => Ok(Self::LevenbergMarquardt),
            "adam" => Ok(Self::Adam),
            _ => Err(PinnError::UnknownName {
                what: "optimiser",
                name: name.to_owned(),
                known: "levenberg-marquardt, adam".to_owned(),
            }),
        }
    }
}

/// Settings of [`crate::identify`]. The default is the hybrid: harmonic VI branch solved linearly,
/// RL-MLP of 2 x 6 by Levenberg-Marquardt, the paper's weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PinnConfig {
    /// Backend that computes the networks.
    pub backend: Backend,
    /// Seed of the RL-MLP's initial weights; the same seed gives the same digits.
    pub seed: u64,
    /// Harmonics of the switching frequency in the VI branch, ascending; must contain 1.
    pub harmonics: Vec<u32>,
    /// Harmonics that the physics term (4) covers; a subset of `harmonics`, ascending. A load with
    /// eddy currents has another R and L at every harmonic, and white noise weighs more on the
    /// higher ones, so the default is the fundamental alone; list all of them for the paper's (4).
    pub physics_harmonics: Vec<u32>,
    /// Relation of R and L at the other physics harmonics, and at a moving envelope, to those of the fundamental: the
    /// number n of Z(s) = s L_0 + K s^n in 0..=0.9, or `identified`, which takes two physics harmonics at least. 0 is the
    /// paper's eq. (1).
    pub impedance_order: ImpedanceOrder,
    /// Most points of a half-cycle to which the VI branch is fitted, 1000..=10000000. In a longer recording each point is the
    /// mean of several samples, which keeps their information on R and L.
    pub most_points: usize,
    /// B-spline intervals per mains half-cycle, 4..=400.
    pub spline_intervals: usize,
    /// Slow collocation times in the window, 16..=4096.
    pub slow_points: usize,
    /// Widths of the RL-MLP's hidden layers, one to eight of 1..=256.
    pub hidden_layers: Vec<usize>,
    /// Inputs of the RL-MLP made from time.
    pub embedding: SlowEmbedding,
    /// Scale of the R output, ohm. Where R is far below it the softplus is an exponential: the prior then limits changes of ln R.
    pub r_scale_ohm: f64,
    /// Scale of the L output, H.
    pub l_scale_h: f64,
    /// Weight of the physics term in eq. (7).
    pub w_f: f64,
    /// Weight of the data terms in eq. (7).
    pub w_i: f64,
    /// Takes R and L from a law of the current that was learned from simulated loads, in closed form, where its residual is no more
    /// than noise explains; the network is trained only elsewhere. Not used with a VI-MLP; for an `ensemble` of 1 only.
    pub at_once: bool,
    /// Expected standard deviation of the RL-MLP's weights. With noise in the samples, a prior of that width keeps R and L from
    /// following the noise. 0 for eq. (7) alone. Levenberg-Marquardt only.
    pub weight_width: f64,
    /// Adds B-splines to the RL-MLP if the evidence supports them: they follow R and L at the ends of the half-cycle, which a
    /// network weighted with I² does not. For one physics harmonic only.
    pub correction: bool,
    /// Measured standard deviation of one sample's white noise in volt and ampere. If `None`, the residual of the data terms is
    /// used, which also contains the harmonics that the VI branch leaves out; the prior is then stronger than needed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<[f64; 2]>,
    /// Optimiser of the RL-MLP.
    pub optimiser: Optimiser,
    /// Learning rate of Adam; Levenberg-Marquardt has none.
    pub learning_rate: f64,
    /// The paper's VI-MLP in place of the harmonic VI branch: both networks are then trained together
    /// by Adam, and `harmonics`, `physics_harmonics`, `impedance_order`, `most_points`, `spline_intervals`,
    /// `weight_width`, `correction`, `noise` and `outer_passes` have no effect.
    pub vi_mlp: Option<ViMlp>,
    /// Number of trainings from successive seeds, 1..=64; the best is the result, the spread is added to its
    /// uncertainty.
    pub ensemble: usize,
    /// Ignores the wall-clock limit, the only thing that makes two runs differ.
    pub deterministic: bool,
    /// Most optimiser steps in all passes together; with a VI-MLP, most epochs.
    pub max_iterations: usize,
    /// Most alternations between the VI branch and the RL-MLP.
    pub outer_passes: usize,
    /// Limit of the mean relative change of R and L, the larger, for convergence: over 2 steps of Levenberg-Marquardt, 200 of
    /// Adam, 200 epochs with a VI-MLP, and over a pass; 0 never. `hybrid` uses four tenths of the standard deviation that
    /// noise would leave for a constant load if that is more.
    pub tolerance: f64,
    /// Wall-clock limit of the optimiser, s; when it is reached, the best parameters so far are the result.
    pub time_limit_s: f64,
    /// Parameters of an earlier result to start from.
    pub start: Option<Parameters>,
    /// Further inputs of the RL-MLP, which belong to one window; not used with a VI-MLP.
    #[serde(skip)]
    pub inputs: Option<SlowInputs>,
}

impl Default for PinnConfig {
    fn default() -> Self {
        Self {
            backend: Backend::default(),
            seed: 1,
            harmonics: ihd_signal::ORDERS.to_vec(),
            physics_harmonics: vec![1],
            impedance_order: ImpedanceOrder::default(),
            most_points: 50_000,
            spline_intervals: 24,
            slow_points: 128,
            hidden_layers: vec![6, 6],
            embedding: SlowEmbedding::default(),
            r_scale_ohm: 20.0,
            l_scale_h: 1e-4,
            w_f: 5.0,
            w_i: 1.0,
            at_once: false,
            weight_width: 0.7,
            correction: true,
            noise: None,
            optimiser: Optimiser::default(),
            learning_rate: 1e-2,
            vi_mlp: None,
            ensemble: 1,
            deterministic: false,
            max_iterations: 400,
            outer_passes: 2,
            tolerance: 2e-5,
            time_limit_s: 10.0,
            start: None,
            inputs: None,
        }
    }
}
