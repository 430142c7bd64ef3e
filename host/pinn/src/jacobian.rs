//! The Jacobian of the physics residuals by the RL-MLP's parameters, in burn tensor operations.
//!
//! burn differentiates a scalar in reverse mode only; a Gauss-Newton step needs every residual's
//! row. So the deltas of back-propagation are carried by hand, for all slow times and both
//! residuals in one batch: `d e / d W = a^T x delta` per row.

use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;

use crate::PinnError;
use crate::loss::SlowTensors;
use crate::rl_mlp::{RlMlp, read};

/// de/dtheta, residuals as in [`SlowTensors::residuals`], parameters as in `Parameters::flat`.
/// Returned row by row.
pub(crate) fn jacobian(physics: &SlowTensors, network: &RlMlp) -> Result<Vec<f64>, PinnError> {
    let (inputs, outputs) = network.activations(physics.features.clone());
    let mut delta = output_delta(physics, outputs);
    let mut blocks = Vec::with_capacity(2 * network.layers.len());
    for (index, (layer, input)) in network.layers.iter().zip(inputs).enumerate().rev() {
        // Both residuals of a slow time see the same activations.
        let input = Tensor::cat(vec![input.clone(), input], 0);
        let [rows, fan_in] = input.dims();
        let [_, fan_out] = delta.dims();
        let outer =
            input.clone().unsqueeze_dim::<3>(2) * delta.clone().unsqueeze_dim::<3>(1);
        blocks.push(delta.clone());
        blocks.push(outer.reshape([rows, fan_in * fan_out]));
        if index > 0 {
            let back = delta.matmul(layer.weight.val().transpose());
            // d tanh = 1 - tanh^2, and `input` is that tanh.
            delta = back * (-(input.clone() * input) + 1.0);
        }
    }
    blocks.reverse();
    read(Tensor::cat(blocks, 1), physics.backend)
}

/// de/d(outputs before the softplus): `-C * diag(sigmoid)`, R rows above L rows.
fn output_delta(physics: &SlowTensors, outputs: Tensor<2>) -> Tensor<2> {
    let slope = -sigmoid(outputs);
    let (r, l) = (slope.clone().narrow(1, 0, 1), slope.narrow(1, 1, 1));
    let r_rows = Tensor::cat(
        vec![physics.c_rr.clone() * r.clone(), physics.c_rl.clone() * l.clone()],
        1,
    );
    // L's residual does not depend on R: C is triangular.
    let l_rows = Tensor::cat(vec![r * 0.0, physics.c_ll.clone() * l], 1);
    Tensor::cat(vec![r_rows, l_rows], 0)
}
