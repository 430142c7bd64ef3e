//! The RL-MLP as plain numbers: R(t) = r_scale softplus(y_0), L(t) = l_scale softplus(y_1), y a multilayer
//! perceptron of the slow features (paper eq. (3)). Used for a warm start, for storage, and for evaluation
//! without burn.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::{SlowEmbedding, SlowInputs};

/// Fully connected layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Weights, `[input][output]`, row by row.
    pub weights: Vec<f64>,
    /// Biases, one per output.
    pub biases: Vec<f64>,
}

/// Trained RL-MLP: all numbers that R(t) and L(t) depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Inputs of the network made from time.
    pub embedding: SlowEmbedding,
    /// Mains frequency of the window, Hz.
    pub f_mains_hz: f64,
    /// Factor of R over the softplus of output 0, ohm.
    pub r_scale_ohm: f64,
    /// Factor of L over the softplus of output 1, H.
    pub l_scale_h: f64,
    /// Hidden layers (tanh) and the output layer.
    pub layers: Vec<Layer>,
    /// VI-MLP (sine); empty for presets without one.
    #[serde(default)]
    pub vi_layers: Vec<Layer>,
    /// Inputs beside the embedding's, of the window that was trained on.
    #[serde(skip)]
    pub inputs: Option<SlowInputs>,
}

/// Number of outputs: R and L.
pub(crate) const OUTPUTS: usize = 2;

impl Parameters {
    /// R (ohm) and L (H) at `t_s` seconds after a mains zero crossing.
    #[must_use]
    pub fn r_l_at(&self, t_s: f64) -> (f64, f64) {
        let [r, l] = self.outputs(&self.features(t_s));
        (self.r_scale_ohm * r, self.l_scale_h * l)
    }

    /// Inputs of the network at `t_s` seconds after a mains zero crossing.
    pub(crate) fn features(&self, t_s: f64) -> Vec<f64> {
        let mut features = self.embedding.features(t_s, self.f_mains_hz);
        features.extend(self.inputs.iter().flat_map(|inputs| inputs.at(t_s)));
        features
    }

    /// Number of inputs.
    pub(crate) fn width(&self) -> usize {
        let further = self.inputs.as_ref().map_or(0, |i| i.functions.len());
        self.embedding.width() + further
    }

    /// R / r_scale and L / l_scale for these features.
    pub(crate) fn outputs(&self, features: &[f64]) -> [f64; OUTPUTS] {
        let mut activations = features.to_vec();
        for (index, layer) in self.layers.iter().enumerate() {
            let hidden = index + 1 < self.layers.len();
            let mut sums = layer.biases.clone();
            for (a, weights) in activations
                .iter()
                .zip(layer.weights.chunks_exact(layer.outputs))
            {
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += a * weight;
                }
            }
            let activation = if hidden { f64::tanh } else { softplus };
            sums.iter_mut().for_each(|sum| *sum = activation(*sum));
            activations = sums;
        }
        [activations[0], activations[1]]
    }

    /// Number of weights and biases.
    pub(crate) fn flat_len(&self) -> usize {
        let layers = self.layers.iter();
        layers.map(|l| l.weights.len() + l.biases.len()).sum()
    }

    /// Widths of the hidden layers.
    #[must_use]
    pub fn hidden_layers(&self) -> Vec<usize> {
        let hidden = self.layers.len().saturating_sub(1);
        self.layers[..hidden].iter().map(|l| l.outputs).collect()
    }

    /// Xavier-Glorot uniform weights from `seed`, zero biases, and an output bias that starts the
    /// network at the constant `start` = (R / r_scale, L / l_scale).
    pub(crate) fn initial(
        mut self,
        hidden_layers: &[usize],
        seed: u64,
        start: [f64; OUTPUTS],
    ) -> Self {
        // Drawn here and not by burn, so that every backend starts from the same digits.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut inputs = self.width();
        self.layers = hidden_layers
            .iter()
            .copied()
            .chain([OUTPUTS])
            .map(|outputs| {
                let limit = (6.0 / (inputs + outputs) as f64).sqrt();
                let layer = Layer {
                    inputs,
                    outputs,
                    weights: (0..inputs * outputs)
                        .map(|_| rng.random_range(-limit..limit))
                        .collect(),
                    biases: vec![0.0; outputs],
                };
                inputs = outputs;
                layer
            })
            .collect();
        self.set_output_biases(start);
        self
    }

    /// Network of this shape whose outputs are the constant (R / r_scale, L / l_scale).
    pub(crate) fn constant(&self, outputs: [f64; OUTPUTS]) -> Self {
        let mut constant = self.with_flat(&vec![0.0; self.flat().len()]);
        constant.set_output_biases(outputs);
        constant
    }

    fn set_output_biases(&mut self, outputs: [f64; OUTPUTS]) {
        if let Some(last) = self.layers.last_mut() {
            last.biases = outputs.iter().map(|y| inverse_softplus(*y)).collect();
        }
    }

    /// All weights and biases, layer by layer, each weights first.
    pub(crate) fn flat(&self) -> Vec<f64> {
        self.layers
            .iter()
            .flat_map(|l| l.weights.iter().chain(&l.biases))
            .copied()
            .collect()
    }

    /// Same network with the weights and biases of `flat`.
    pub(crate) fn with_flat(&self, flat: &[f64]) -> Self {
        let mut next = self.clone();
        let mut values = flat.iter();
        for layer in &mut next.layers {
            for (slot, value) in layer
                .weights
                .iter_mut()
                .chain(&mut layer.biases)
                .zip(&mut values)
            {
                *slot = *value;
            }
        }
        next
    }

    /// Returns `true` if the layers chain from the features to R and L, with finite numbers.
    pub(crate) fn is_sound(&self) -> bool {
        let mut inputs = self.width();
        let chained = self.layers.iter().all(|l| {
            let fits = l.inputs == inputs
                && l.weights.len() == l.inputs * l.outputs
                && l.biases.len() == l.outputs;
            inputs = l.outputs;
            fits
        });
        chained && inputs == OUTPUTS && self.flat().iter().all(|x| x.is_finite())
    }
}

/// ln(1 + e^x), without overflow.
pub(crate) fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Inverse of [`softplus`] for y > 0; limited to -20 below e^-20.
fn inverse_softplus(y: f64) -> f64 {
    let y = y.max((-20.0_f64).exp());
    y + (-(-y).exp_m1()).ln()
}

#[cfg(test)]
mod tests {
    use super::{inverse_softplus, softplus};

    #[test]
    fn inverse_softplus_undoes_softplus() {
        for x in [-15.0, -1.0, 0.0, 0.5413, 3.0, 40.0] {
            assert!((inverse_softplus(softplus(x)) - x).abs() < 1e-9);
        }
    }
}
