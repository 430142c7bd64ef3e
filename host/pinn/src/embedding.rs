//! Slow features φ(t), the RL-MLP's inputs: the paper's eq. (3), and two with its n from 0.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Features of the time since the mains zero crossing that feed the RL-MLP.
///
/// The paper's eq. (3) counts n from 1, so that R and L repeat three times per half-cycle. Its sine is also
/// smooth at each crossing, where the envelope has a kink. The first two
/// embeddings start at the fundamental of the envelope and contain the envelope itself, |sin|.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlowEmbedding {
    /// `|sin(2 pi f_mains t)|, cos(2 pi f_mains t)`: distinguishes the rising from the falling half of the
    /// envelope, so that R(t) and L(t) may be asymmetric.
    #[default]
    MainsPhase,
    /// `|sin(2 pi f_mains t)|, cos(2 pi 2 f_mains t)`: both even about the crest, so that R(t) and L(t)
    /// are symmetric; slightly less noise if the load is symmetric.
    Symmetric,
    /// Eq. (3): sine and cosine of `2 pi (2n + 1) 2 f_mains t` for `count` values of n from
    /// `first`; the paper has first = 1, count = 1.
    Fourier {
        /// First n.
        first: u32,
        /// N_mains, 1..=16.
        count: u32,
    },
}

impl SlowEmbedding {
    /// Number of features.
    pub(crate) fn width(self) -> usize {
        match self {
            Self::MainsPhase | Self::Symmetric => 2,
            Self::Fourier { count, .. } => 2 * count as usize,
        }
    }

    /// The features at `t_s` seconds after a mains zero crossing, each within -1..=1.
    pub(crate) fn features(self, t_s: f64, f_mains_hz: f64) -> Vec<f64> {
        let phase = TAU * f_mains_hz * t_s;
        match self {
            Self::MainsPhase => vec![phase.sin().abs(), phase.cos()],
            Self::Symmetric => vec![phase.sin().abs(), (2.0 * phase).cos()],
            Self::Fourier { first, count } => (first..first + count)
                .flat_map(|n| {
                    let (sin, cos) = (2.0 * f64::from(2 * n + 1) * phase).sin_cos();
                    [sin, cos]
                })
                .collect(),
        }
    }

    /// Time derivatives of the features, 1/s: their exact tangent.
    pub(crate) fn rates_per_s(self, t_s: f64, f_mains_hz: f64) -> Vec<f64> {
        let omega = TAU * f_mains_hz;
        let phase = omega * t_s;
        let envelope = omega * phase.sin().signum() * phase.cos();
        match self {
            Self::MainsPhase => vec![envelope, -omega * phase.sin()],
            Self::Symmetric => vec![envelope, -2.0 * omega * (2.0 * phase).sin()],
            Self::Fourier { first, count } => (first..first + count)
                .flat_map(|n| {
                    let order = 2.0 * f64::from(2 * n + 1);
                    let (sin, cos) = (order * phase).sin_cos();
                    [order * omega * cos, -order * omega * sin]
                })
                .collect(),
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
        let rising = SlowEmbedding::MainsPhase.features(early, 50.0)[1];
        let falling = SlowEmbedding::MainsPhase.features(late, 50.0)[1];
        assert!((rising + falling).abs() < 1e-12 && rising > 0.5);
    }

    #[test]
    fn rates_are_the_slopes_of_the_features() {
        let all = [
            SlowEmbedding::MainsPhase,
            SlowEmbedding::Symmetric,
            SlowEmbedding::Fourier { first: 0, count: 3 },
        ];
        for embedding in all {
            for t_s in [0.4e-3, 3.3e-3, 7.9e-3, 13e-3] {
                let step_s = 1e-7;
                let after = embedding.features(t_s + step_s, 50.0);
                let before = embedding.features(t_s - step_s, 50.0);
                let rates = embedding.rates_per_s(t_s, 50.0);
                assert_eq!(rates.len(), embedding.width());
                for ((a, b), rate) in after.iter().zip(&before).zip(rates) {
                    let numeric = (a - b) / (2.0 * step_s);
                    assert!((numeric - rate).abs() < 1e-4 * (1.0 + rate.abs()));
                }
            }
        }
    }

    #[test]
    fn the_papers_eq_3_repeats_three_times_per_half_cycle() {
        let paper = SlowEmbedding::Fourier { first: 1, count: 1 };
        let (here, next) = (
            paper.features(1e-3, 50.0),
            paper.features(1e-3 + 10e-3 / 3.0, 50.0),
        );
        assert!(here.iter().zip(next).all(|(a, b)| (a - b).abs() < 1e-9));
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
