//! Settings of an identification.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::impedance_law::MOST;
use crate::{
    Backend, ImpedanceOrder, Parameters, PinnError, Preset, PresetLibrary, SlowEmbedding, ViMlp,
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
    /// `weight_width` and `outer_passes` mean nothing.
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
    /// Stop when R and L move by less than this, as a mean of the relative change over a few steps; 0
    /// never. Where noise allows no more, `hybrid` stops at a tenth of what it leaves uncertain.
    pub tolerance: f64,
    /// Wall-clock limit of the optimiser, s. Reached, the best parameters so far are the result.
    pub time_limit_s: f64,
    /// Parameters of an earlier result to start from.
    pub start: Option<Parameters>,
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

    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// [`PinnError::Config`] or [`PinnError::WarmStart`] for the first field out of range.
    pub fn validate(&self) -> Result<(), PinnError> {
        self.validate_harmonics()?;
        within("most_points", self.most_points, 1000..=10_000_000)?;
        within("spline_intervals", self.spline_intervals, 4..=400)?;
        within("slow_points", self.slow_points, 16..=4096)?;
        within("hidden_layers count", self.hidden_layers.len(), 1..=8)?;
        for width in &self.hidden_layers {
            within("hidden_layers width", *width, 1..=256)?;
        }
        within("outer_passes", self.outer_passes, 1..=100)?;
        within("max_iterations", self.max_iterations, 1..=10_000_000)?;
        for (field, value) in [
            ("r_scale_ohm", self.r_scale_ohm),
            ("l_scale_h", self.l_scale_h),
            ("w_f", self.w_f),
            ("w_i", self.w_i),
            ("learning_rate", self.learning_rate),
            ("time_limit_s", self.time_limit_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(PinnError::Config {
                    field,
                    problem: format!("is {value}, but must be a positive number"),
                });
            }
        }
        for (field, value) in [
            ("weight_width", self.weight_width),
            ("tolerance", self.tolerance),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(PinnError::Config {
                    field,
                    problem: format!("is {value}, but must be zero or positive"),
                });
            }
        }
        if let Some(value) = self
            .noise
            .iter()
            .flatten()
            .find(|s| !(0.0..f64::MAX).contains(*s))
        {
            return Err(PinnError::Config {
                field: "noise",
                problem: format!("holds {value}, but must be zero or positive"),
            });
        }
        within("ensemble", self.ensemble, 1..=64)?;
        validate_embedding("embedding", self.embedding)?;
        self.validate_networks()?;
        self.validate_start()
    }

    fn validate_networks(&self) -> Result<(), PinnError> {
        let Some(vi) = &self.vi_mlp else {
            return if self.backend.is_double() {
                Ok(())
            } else {
                Err(PinnError::Config {
                    field: "backend",
                    problem: format!(
                        "{} has no double precision, which the harmonic branch needs: take fused, \
                         flex or ndarray",
                        self.backend
                    ),
                })
            };
        };
        if self.optimiser != Optimiser::Adam {
            return Err(PinnError::Config {
                field: "optimiser",
                problem: "must be adam with a VI-MLP: Levenberg-Marquardt is for the harmonic \
                          branch"
                    .to_owned(),
            });
        }
        within("vi_mlp.hidden_layers count", vi.hidden_layers.len(), 1..=8)?;
        for width in &vi.hidden_layers {
            within("vi_mlp.hidden_layers width", *width, 1..=256)?;
        }
        within("vi_mlp.n_sw", vi.n_sw as usize, 1..=16)?;
        within("vi_mlp.first_m", vi.first_m as usize, 0..=16)?;
        within("vi_mlp.downsampling", vi.downsampling, 1..=1000)?;
        within("vi_mlp.balance_every", vi.balance_every, 0..=10_000_000)?;
        if let Some(minibatch) = vi.minibatch {
            within("vi_mlp.minibatch", minibatch, 16..=10_000_000)?;
        }
        if let Some(slow) = vi.slow {
            validate_embedding("vi_mlp.slow", slow)?;
        }
        if vi.last_rate.is_finite() && vi.last_rate > 0.0 && vi.last_rate <= 1.0 {
            Ok(())
        } else {
            Err(PinnError::Config {
                field: "vi_mlp.last_rate",
                problem: format!("is {}, but must be above 0 and up to 1", vi.last_rate),
            })
        }
    }

    fn validate_harmonics(&self) -> Result<(), PinnError> {
        let ascending = |list: &[u32]| list.windows(2).all(|pair| pair[0] < pair[1]);
        let wrong = |field, problem: &str| {
            Err(PinnError::Config {
                field,
                problem: problem.to_owned(),
            })
        };
        if self.harmonics.first() != Some(&1) || !ascending(&self.harmonics) {
            return wrong("harmonics", "must ascend from 1, the fundamental");
        }
        if self.harmonics.len() > 32 {
            return wrong("harmonics", "has more than 32 entries");
        }
        let known = |h| self.harmonics.contains(h);
        if self.physics_harmonics.is_empty()
            || !ascending(&self.physics_harmonics)
            || !self.physics_harmonics.iter().all(known)
        {
            return wrong(
                "physics_harmonics",
                "must be a non-empty ascending selection of harmonics",
            );
        }
        match self.impedance_order {
            ImpedanceOrder::Given(n) if !(0.0..=MOST).contains(&n) => Err(PinnError::Config {
                field: "impedance_order",
                problem: format!("is {n}, but must be 0 to {MOST}"),
            }),
            ImpedanceOrder::Named(_) if self.physics_harmonics.len() < 2 => wrong(
                "impedance_order",
                "is identified, but with one physics harmonic there is nothing to see it from: give \
                 two at least",
            ),
            _ => Ok(()),
        }
    }

    fn validate_start(&self) -> Result<(), PinnError> {
        let Some(start) = &self.start else {
            return Ok(());
        };
        let found = start.hidden_layers();
        if found == self.hidden_layers && start.is_sound() {
            return Ok(());
        }
        Err(PinnError::WarmStart {
            found: format!(
                "{found:?}{}",
                if start.is_sound() { "" } else { " (damaged)" }
            ),
            wanted: format!("{:?}", self.hidden_layers),
        })
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

fn validate_embedding(field: &'static str, embedding: SlowEmbedding) -> Result<(), PinnError> {
    match embedding {
        SlowEmbedding::MainsPhase | SlowEmbedding::Symmetric => Ok(()),
        SlowEmbedding::Fourier { first, count } => {
            within(field, first as usize, 0..=16)?;
            within(field, count as usize, 1..=16)
        }
    }
}

fn within(
    field: &'static str,
    value: usize,
    range: std::ops::RangeInclusive<usize>,
) -> Result<(), PinnError> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(PinnError::Config {
            field,
            problem: format!(
                "is {value}, but must be {} to {}",
                range.start(),
                range.end()
            ),
        })
    }
}
