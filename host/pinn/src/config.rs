//! Settings of an identification, their ranges, and how a TOML file lies over a preset.

mod ranges;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{
    Backend, ImpedanceOrder, Parameters, PinnError, Preset, PresetLibrary, SlowEmbedding,
    SlowInputs, ViMlp,
};

/// What trains the RL-MLP on the physics term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Optimiser {
    /// Damped Gauss-Newton on all slow times at once.
    #[default]
    LevenbergMarquardt,
    /// Adam on the gradient from burn's reverse mode, as in the paper: for comparison.
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
/// RL-MLP of 2 x 8 by Levenberg-Marquardt, the paper's weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What computes the networks.
    pub backend: Backend,
    /// Seed of the RL-MLP's first weights; the same seed gives the same digits.
    pub seed: u64,
    /// Harmonics of the switching frequency in the VI branch; must hold 1, ascending.
    pub harmonics: Vec<u32>,
    /// Harmonics that the physics term (4) covers; a subset of `harmonics`, ascending. A load with
    /// eddy currents has another R and L at every harmonic, and white noise weighs more on the
    /// higher ones, so the default is the fundamental alone; list all of them for the paper's (4).
    pub physics_harmonics: Vec<u32>,
    /// How R and L carry over from the fundamental to the other physics harmonics, and to a moving
    /// envelope: the number n of Z(s) = s L_0 + K s^n in 0..=0.9, or `identified`, which takes two
    /// physics harmonics at least. 0 is the paper's eq. (1).
    pub impedance_order: ImpedanceOrder,
    /// Points of a half-cycle that the VI branch is fitted to, 1000..=10000000: of a longer recording
    /// each is the mean of as many samples, which keeps what they know of R and L.
    pub most_points: usize,
    /// B-spline intervals per mains half-cycle, 4..=400.
    pub spline_intervals: usize,
    /// Slow collocation times in the window, 16..=4096.
    pub slow_points: usize,
    /// Widths of the RL-MLP's hidden layers, one to eight of 1..=256.
    pub hidden_layers: Vec<usize>,
    /// How time enters the RL-MLP.
    pub embedding: SlowEmbedding,
    /// Scale of the R output, ohm.
    pub r_scale_ohm: f64,
    /// Scale of the L output, H.
    pub l_scale_h: f64,
    /// Weight of the physics term in eq. (7).
    pub w_f: f64,
    /// Weight of the data terms in eq. (7).
    pub w_i: f64,
    /// Standard deviation expected of the RL-MLP's weights: with noise in the samples, a prior of
    /// that width keeps R and L from following it. 0 for eq. (7) alone. Levenberg-Marquardt only.
    pub weight_width: f64,
    /// B-splines on top of the RL-MLP, where the evidence is for them: they follow R and L at the ends of the
    /// half-cycle, which a network weighted with I² does not. For one physics harmonic.
    pub correction: bool,
    /// Standard deviation of one sample's white noise in volt and ampere, where it was measured. Else
    /// the residual of the data terms stands for it, which also holds the harmonics that the VI branch
    /// leaves out: the prior is then stronger than the noise asks for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<[f64; 2]>,
    /// What trains the RL-MLP.
    pub optimiser: Optimiser,
    /// Learning rate of Adam; Levenberg-Marquardt has none.
    pub learning_rate: f64,
    /// The paper's VI-MLP in place of the harmonic VI branch: both networks are then trained together
    /// by Adam, and `harmonics`, `physics_harmonics`, `impedance_order`, `most_points`, `spline_intervals`,
    /// `weight_width`, `correction`, `noise` and `outer_passes` mean nothing.
    pub vi_mlp: Option<ViMlp>,
    /// Trains so many times from successive seeds, 1..=64; the best is the result, the spread its
    /// uncertainty.
    pub ensemble: usize,
    /// Ignores the wall-clock limit, the only thing that makes two runs differ.
    pub deterministic: bool,
    /// Most optimiser steps in all passes together, with a VI-MLP: epochs.
    pub max_iterations: usize,
    /// Most alternations between the VI branch and the RL-MLP.
    pub outer_passes: usize,
    /// Converged when the mean relative change of R and L, the larger, is below this: over 5 steps of
    /// Levenberg-Marquardt, 200 of Adam, 200 epochs with a VI-MLP, and over a pass; 0 never. `hybrid` takes a
    /// tenth of the standard deviation that noise would leave for a constant load where that is more.
    pub tolerance: f64,
    /// Wall-clock limit of the optimiser, s. Reached, the best parameters so far are the result.
    pub time_limit_s: f64,
    /// Parameters of an earlier result to start from.
    pub start: Option<Parameters>,
    /// Further inputs of the RL-MLP, which belong to one window; the presets with a VI-MLP have no use for them.
    #[serde(skip)]
    pub inputs: Option<SlowInputs>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            backend: Backend::default(),
            seed: 1,
            harmonics: vec![1, 3, 5, 7],
            physics_harmonics: vec![1],
            impedance_order: ImpedanceOrder::default(),
            most_points: 50_000,
            spline_intervals: 24,
            slow_points: 128,
            hidden_layers: vec![8, 8],
            embedding: SlowEmbedding::default(),
            r_scale_ohm: 4.0,
            l_scale_h: 20e-6,
            w_f: 5.0,
            w_i: 1.0,
            weight_width: 1.0,
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

impl Config {
    /// Reads a TOML file: settings by their names, on top of the preset that its key `preset` names
    /// (`hybrid` without one), one of the program's. A `description` is for the reader.
    ///
    /// # Errors
    /// [`PinnError::File`] with the parser's words, [`PinnError::UnknownName`], or what
    /// [`Self::validate`] gives.
    pub fn from_toml(text: &str) -> Result<Self, PinnError> {
        Self::from_described_toml(text).map(|(config, _)| config)
    }

    /// The same with the description.
    pub(crate) fn from_described_toml(text: &str) -> Result<(Self, Option<String>), PinnError> {
        let refused = |e: &dyn fmt::Display| PinnError::File {
            detail: e.to_string(),
        };
        let mut given: toml::Table = text.parse().map_err(|e: toml::de::Error| refused(&e))?;
        let mut word = |key: &str| match given.remove(key) {
            None => Ok(None),
            Some(toml::Value::String(word)) => Ok(Some(word)),
            Some(other) => Err(refused(&format!("{key} is {other}, not a text"))),
        };
        let (preset, description) = (word("preset")?, word("description")?);
        let preset = preset.as_deref().unwrap_or(Preset::default().name());
        let base = PresetLibrary::default().get(preset)?.config;
        // Beforehand: these errors list the names that there are.
        if let Some(toml::Value::String(name)) = given.get("backend") {
            name.parse::<Backend>()?;
        }
        if let Some(toml::Value::String(name)) = given.get("optimiser") {
            name.parse::<Optimiser>()?;
        }
        let mut table = toml::Table::try_from(base).map_err(|e| refused(&e))?;
        overlay(&mut table, given);
        let config: Self = table.try_into().map_err(|e: toml::de::Error| refused(&e))?;
        config.validate()?;
        Ok((config, description))
    }
}

/// Puts `given` over `table`, tables within tables likewise.
fn overlay(table: &mut toml::Table, given: toml::Table) {
    for (key, value) in given {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) if key == "vi_mlp" => {
                overlay(below, above);
            }
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}
