//! Configurations in code: those of the paper as written and repaired, and this project's. Ablations are files:
//! [`crate::PresetLibrary`].

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{ImpedanceOrder, NamedOrder, Optimiser, PinnConfig, PinnError, SlowEmbedding, ViMlp};

/// A [`PinnConfig`] with a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Harmonic VI branch solved linearly, RL-MLP of 2 x 6 by Levenberg-Marquardt.
    #[default]
    Hybrid,
    /// The paper as written: eqs. (2), (3) with m, n from 1, outputs not scaled.
    PaperLiteral,
    /// The paper's networks repaired: m, n from 0, slow features in both, scaled outputs.
    PaperRepaired,
    /// `paper-literal` with scaled outputs.
    LiteralScaled,
    /// `hybrid` with the physics term over all harmonics.
    HybridAllHarmonics,
    /// `hybrid` with the physics term over all harmonics and an impedance law whose order is identified
    /// along with R and L.
    HybridFractional,
    /// `hybrid` with harmonics up to the 31st, for waveforms: R and L need the 7th at most.
    HybridWaveform,
}

/// Epochs of the paper's training.
const PAPER_EPOCHS: usize = 5000;

impl Preset {
    /// All presets.
    pub const ALL: [Self; 7] = [
        Self::Hybrid,
        Self::PaperLiteral,
        Self::PaperRepaired,
        Self::LiteralScaled,
        Self::HybridAllHarmonics,
        Self::HybridFractional,
        Self::HybridWaveform,
    ];

    /// Name of the preset on the command line and in configuration files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hybrid => "hybrid",
            Self::PaperLiteral => "paper-literal",
            Self::PaperRepaired => "paper-repaired",
            Self::LiteralScaled => "literal-scaled",
            Self::HybridAllHarmonics => "hybrid-all-harmonics",
            Self::HybridFractional => "hybrid-fractional",
            Self::HybridWaveform => "hybrid-waveform",
        }
    }

    /// Description of the preset, with its known errors.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Hybrid => {
                "harmonic VI branch solved linearly, RL-MLP of 2 x 6 by Levenberg-Marquardt; harmonics up \
                 to the 7th, so NMSE_v holds what the edges have beyond"
            }
            Self::PaperLiteral => {
                "the paper as printed. Fails: softplus near 0 is 0.7, so L starts near 0.7 H, and the \
                 physics term of that size leaves nothing of v and i; and with m from 1 the VI-MLP \
                 cannot see the mains envelope"
            }
            Self::LiteralScaled => {
                "the same with outputs times 4 ohm and 20 uH. Fails: the VI-MLP cannot see the envelope, \
                 and eq. (3) with n from 1 repeats three times a half-cycle"
            }
            Self::PaperRepaired => {
                "m from 0, slow features in both networks, scaled outputs; what is left at the ends of \
                 the half-cycle is Adam's"
            }
            Self::HybridAllHarmonics => {
                "hybrid, one R and one L for all harmonics: wrong where the load has eddy currents"
            }
            Self::HybridFractional => {
                "hybrid, all harmonics under Z(s) = s L_0 + K s^n with n identified"
            }
            Self::HybridWaveform => "hybrid with harmonics up to the 31st",
        }
    }

    /// Settings of the preset.
    #[must_use]
    pub fn config(self) -> PinnConfig {
        let hybrid = PinnConfig::default();
        match self {
            Self::Hybrid => hybrid,
            Self::HybridAllHarmonics => PinnConfig {
                physics_harmonics: hybrid.harmonics.clone(),
                correction: false,
                ..hybrid
            },
            Self::HybridFractional => PinnConfig {
                impedance_order: ImpedanceOrder::Named(NamedOrder::Identified),
                ..Self::HybridAllHarmonics.config()
            },
            Self::HybridWaveform => PinnConfig {
                harmonics: (1..=31).step_by(2).collect(),
                // Eight points per period of the 31st harmonic allow no longer blocks.
                most_points: 200_000,
                ..hybrid
            },
            Self::PaperLiteral => unscaled(Self::LiteralScaled.config()),
            Self::LiteralScaled => PinnConfig {
                embedding: PAPER_EQ_3,
                ..paper(ViMlp {
                    first_m: 1,
                    slow: None,
                    ..ViMlp::default()
                })
            },
            Self::PaperRepaired => paper(ViMlp::default()),
        }
    }
}

/// Eq. (3) with N_mains = 1.
const PAPER_EQ_3: SlowEmbedding = SlowEmbedding::Fourier { first: 1, count: 1 };

/// Settings common to all presets with a VI-MLP: the paper's RL-MLP and training.
fn paper(vi: ViMlp) -> PinnConfig {
    PinnConfig {
        vi_mlp: Some(vi),
        embedding: SlowEmbedding::Symmetric,
        hidden_layers: vec![16; 4],
        r_scale_ohm: 4.0,
        l_scale_h: 20e-6,
        optimiser: Optimiser::Adam,
        learning_rate: 1e-3,
        max_iterations: PAPER_EPOCHS,
        tolerance: 0.0,
        time_limit_s: 3600.0,
        ..PinnConfig::default()
    }
}

/// Settings with R in ohm and L in henry straight from the softplus.
fn unscaled(config: PinnConfig) -> PinnConfig {
    PinnConfig {
        r_scale_ohm: 1.0,
        l_scale_h: 1.0,
        ..config
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Preset {
    type Err = PinnError;

    /// Reads the name of one of [`Self::ALL`].
    ///
    /// # Errors
    /// [`PinnError::UnknownName`] for anything else.
    fn from_str(name: &str) -> Result<Self, PinnError> {
        let mut all = Self::ALL.into_iter();
        all.find(|preset| preset.name() == name)
            .ok_or_else(|| PinnError::UnknownName {
                what: "preset",
                name: name.to_owned(),
                known: Self::ALL.map(Self::name).join(", "),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_serde_and_every_preset_is_valid() {
        for preset in Preset::ALL {
            assert_eq!(preset.name().parse(), Ok(preset));
            let quoted = serde_json::to_string(&preset).expect("a name");
            assert_eq!(quoted, format!("\"{}\"", preset.name()));
            assert_eq!(preset.config().validate(), Ok(()));
        }
        assert!("paper".parse::<Preset>().is_err());
    }

    #[test]
    fn the_literal_preset_is_what_the_paper_prints() {
        let config = Preset::PaperLiteral.config();
        let vi = config.vi_mlp.expect("has the paper's VI-MLP");
        assert_eq!((vi.hidden_layers, vi.n_sw, vi.first_m), (vec![64; 3], 3, 1));
        assert_eq!((vi.slow, vi.downsampling, vi.minibatch), (None, 10, None));
        assert_eq!(config.hidden_layers, vec![16; 4]);
        assert_eq!(
            (config.w_f, config.w_i, config.learning_rate),
            (5.0, 1.0, 1e-3)
        );
        assert_eq!(config.max_iterations, 5000);
        assert_eq!((config.r_scale_ohm, config.l_scale_h), (1.0, 1.0));
    }
}
