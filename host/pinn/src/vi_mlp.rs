//! Settings of the paper's VI-MLP, and its inputs (paper eq. (2)).

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::SlowEmbedding;

/// The VI-MLP: a multilayer perceptron with sine activations whose outputs are v(t) and i(t), trained
/// together with the RL-MLP on all samples by Adam.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ViMlp {
    /// Widths of the hidden layers, one to eight of 1..=256.
    pub hidden_layers: Vec<usize>,
    /// First m of eq. (2): the paper counts from 1 and thereby leaves out the fundamental.
    pub first_m: u32,
    /// N_sw of eq. (2), 1..=16.
    pub n_sw: u32,
    /// Slow features as inputs beside eq. (2); the paper has none, so that the network does not know the envelope. `None` if not
    /// given in a file.
    #[serde(default)]
    pub slow: Option<SlowEmbedding>,
    /// Distance of used samples, 1..=1000.
    pub downsampling: usize,
    /// Points per gradient step; all of them if `None`.
    pub minibatch: Option<usize>,
    /// Learning rate of the last epoch relative to the first; it falls geometrically. 1 is the
    /// paper's constant rate.
    pub last_rate: f64,
    /// Number of epochs after which w_f is set so that the gradients of physics term and data terms have the same
    /// length; 0 never.
    pub balance_every: usize,
}

impl Default for ViMlp {
    /// The paper's network repaired: m from 0, which includes the fundamental, and slow features, which include the envelope.
    fn default() -> Self {
        Self {
            hidden_layers: vec![64; 3],
            first_m: 0,
            n_sw: 3,
            slow: Some(SlowEmbedding::Symmetric),
            downsampling: 10,
            minibatch: None,
            last_rate: 1.0,
            balance_every: 0,
        }
    }
}

impl ViMlp {
    /// Number of inputs.
    pub(crate) fn width(&self) -> usize {
        2 * self.n_sw as usize + self.slow.map_or(0, SlowEmbedding::width)
    }

    /// Inputs at `t_s` seconds after a mains zero crossing, and their derivatives per radian of the switching
    /// frequency.
    pub(crate) fn features(&self, t_s: f64, f_sw_hz: f64, f_mains_hz: f64) -> (Vec<f64>, Vec<f64>) {
        let (mut values, mut rates) = (Vec::new(), Vec::new());
        for m in self.first_m..self.first_m + self.n_sw {
            let order = f64::from(2 * m + 1);
            let (sin, cos) = (TAU * order * f_sw_hz * t_s).sin_cos();
            values.extend([sin, cos]);
            rates.extend([order * cos, -order * sin]);
        }
        if let Some(slow) = self.slow {
            let per_radian = (TAU * f_sw_hz).recip();
            values.extend(slow.features(t_s, f_mains_hz));
            let slow_rates = slow.rates_per_s(t_s, f_mains_hz);
            rates.extend(slow_rates.iter().map(|rate| rate * per_radian));
        }
        (values, rates)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embeddings_tangent_is_its_finite_difference() {
        let vi = ViMlp::default();
        let (f_sw_hz, f_mains_hz) = (45e3, 50.0);
        let step_s = 1e-10;
        for t_s in [0.7e-3, 4.123_4e-3, 9.2e-3] {
            let (after, _) = vi.features(t_s + step_s, f_sw_hz, f_mains_hz);
            let (before, _) = vi.features(t_s - step_s, f_sw_hz, f_mains_hz);
            let (values, rates) = vi.features(t_s, f_sw_hz, f_mains_hz);
            assert_eq!((values.len(), rates.len()), (vi.width(), vi.width()));
            for ((a, b), rate) in after.iter().zip(&before).zip(rates) {
                let numeric = (a - b) / (2.0 * step_s * TAU * f_sw_hz);
                assert!((numeric - rate).abs() < 1e-5, "{numeric} against {rate}");
            }
        }
    }

    #[test]
    fn the_papers_eq_2_has_no_fundamental() {
        let literal = ViMlp {
            first_m: 1,
            slow: None,
            ..ViMlp::default()
        };
        // Third harmonic and above repeat after a third of the switching period only together with
        // the third; after a whole period all do.
        let (here, _) = literal.features(0.0, 45e3, 50.0);
        let (next, _) = literal.features(1.0 / 45e3, 45e3, 50.0);
        assert!(here.iter().zip(next).all(|(a, b)| (a - b).abs() < 1e-9));
        let (third, _) = literal.features(1.0 / (3.0 * 45e3), 45e3, 50.0);
        assert!((here[0] - third[0]).abs() < 1e-9 && (here[1] - third[1]).abs() < 1e-9);
        assert_eq!(literal.width(), 6);
    }
}
