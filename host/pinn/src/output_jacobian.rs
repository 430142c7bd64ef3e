//! Derivatives of the RL-MLP's outputs by its parameters, in plain double precision.

use crate::parameters::{OUTPUTS, Parameters};

/// Derivatives of R / r_scale and of L / l_scale by all parameters in the order of
/// `Parameters::flat`: a forward pass, and one backward pass per output.
pub(crate) fn output_rows(parameters: &Parameters, features: &[f64]) -> [Vec<f64>; OUTPUTS] {
    let mut inputs = vec![features.to_vec()];
    let mut last = Vec::new();
    for (index, layer) in parameters.layers.iter().enumerate() {
        let x = &inputs[index];
        let mut sums = layer.biases.clone();
        for (a, weights) in x.iter().zip(layer.weights.chunks_exact(layer.outputs)) {
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum += a * weight;
            }
        }
        if index + 1 < parameters.layers.len() {
            sums.iter_mut().for_each(|s| *s = s.tanh());
            inputs.push(sums);
        } else {
            last = sums;
        }
    }
    let count = parameters.flat_len();
    let mut rows = std::array::from_fn(|_| vec![0.0; count]);
    for (o, row) in rows.iter_mut().enumerate() {
        // softplus' = 1 / (1 + e^-x).
        let mut delta = vec![0.0; OUTPUTS];
        delta[o] = (1.0 + (-last[o]).exp()).recip();
        back(parameters, &inputs, delta, row);
    }
    rows
}

/// Carries `delta`, the derivative by the last layer's sums, back through all layers.
fn back(parameters: &Parameters, inputs: &[Vec<f64>], mut delta: Vec<f64>, row: &mut [f64]) {
    let mut end = row.len();
    for (layer, x) in parameters.layers.iter().zip(inputs).rev() {
        let start = end - layer.weights.len() - layer.biases.len();
        let (by_weights, by_biases) = row[start..end].split_at_mut(layer.weights.len());
        by_biases.copy_from_slice(&delta);
        for (a, by_weights) in x.iter().zip(by_weights.chunks_exact_mut(layer.outputs)) {
            for (by_weight, d) in by_weights.iter_mut().zip(&delta) {
                *by_weight = a * d;
            }
        }
        // d tanh = 1 - tanh^2, and x is that tanh; the first layer's x are features, and unused.
        let weights = layer.weights.chunks_exact(layer.outputs);
        delta = weights
            .zip(x)
            .map(|(weights, a)| {
                let sum: f64 = weights.iter().zip(&delta).map(|(w, d)| w * d).sum();
                sum * (1.0 - a * a)
            })
            .collect();
        end = start;
    }
}

#[cfg(test)]
mod tests {
    use super::output_rows;
    use crate::trial;

    #[test]
    fn the_derivatives_are_finite_differences() {
        let network = trial::network();
        let features = network.embedding.features(2.7e-3, 50.0);
        let rows = output_rows(&network, &features);
        let flat = network.flat();
        let step = 1e-6;
        for p in 0..flat.len() {
            let at = |shift: f64| {
                let mut moved = flat.clone();
                moved[p] += shift;
                network.with_flat(&moved).outputs(&features)
            };
            let (after, before) = (at(step), at(-step));
            for o in 0..2 {
                let numeric = (after[o] - before[o]) / (2.0 * step);
                assert!((numeric - rows[o][p]).abs() < 1e-8);
            }
        }
    }
}
