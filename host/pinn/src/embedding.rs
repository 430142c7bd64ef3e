//! Slow features: how the RL-MLP sees time (paper eq. (3), repaired).

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Features of the time since the mains zero crossing that feed the RL-MLP.
///
/// The paper's eq. (3) counts n from 1, so that R and L repeat three times per half-cycle; and its
/// sine has a kinkless zero at each crossing, where the envelope has a kink. Both embeddings here
/// start at the fundamental of the envelope and carry the envelope itself, |sin|.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlowEmbedding {
    /// `|sin(2 pi f_mains t)|, cos(2 pi f_mains t)`: tells the rising from the falling half of the
    /// envelope, so R(t) and L(t) may be asymmetric.
    #[default]
    MainsPhase,
    /// `|sin(2 pi f_mains t)|, cos(2 pi 2 f_mains t)`: both even about the crest, so R(t) and L(t)
    /// are symmetric: a little less noise, where that is true of the load.
    Symmetric,
}

impl SlowEmbedding {
    /// Number of features.
    pub(crate) const WIDTH: usize = 2;

    /// The features at `t_s` seconds after a mains zero crossing, each within -1..=1.
    pub(crate) fn features(self, t_s: f64, f_mains_hz: f64) -> [f64; Self::WIDTH] {
        let phase = TAU * f_mains_hz * t_s;
        match self {
            Self::MainsPhase => [phase.sin().abs(), phase.cos()],
            Self::Symmetric => [phase.sin().abs(), (2.0 * phase).cos()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SlowEmbedding;

    #[test]
    fn symmetric_embedding_is_even_about_the_crest_and_mains_phase_is_not() {
        let (early, late) = (2e-3, 8e-3);
        for (a, b) in SlowEmbedding::Symmetric
            .features(early, 50.0)
            .iter()
            .zip(SlowEmbedding::Symmetric.features(late, 50.0))
        {
            assert!((a - b).abs() < 1e-12);
        }
        let [_, rising] = SlowEmbedding::MainsPhase.features(early, 50.0);
        let [_, falling] = SlowEmbedding::MainsPhase.features(late, 50.0);
        assert!((rising + falling).abs() < 1e-12 && rising > 0.5);
    }

    #[test]
    fn features_repeat_every_half_cycle_of_the_envelope() {
        for mains in [50.0, 60.0] {
            let half_cycle = 0.5 / mains;
            let here = SlowEmbedding::Symmetric.features(1.7e-3, mains);
            let next = SlowEmbedding::Symmetric.features(1.7e-3 + half_cycle, mains);
            assert!(here.iter().zip(next).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }
}
