//! Jacobian of the physics residuals by the RL-MLP's parameters, in burn tensor operations.
//!
//! burn differentiates a scalar in reverse mode only, but a Gauss-Newton step needs the row of every
//! residual. The deltas of back-propagation are therefore computed by hand, for all slow times and both
//! residuals in one batch: `d e / d W = a^T x delta` per row.

use burn::tensor::Tensor;
use nalgebra::DMatrix;

use crate::PinnError;
use crate::loss::SlowTensors;
use crate::rl_mlp::{RlMlp, read};

/// de/dtheta, residuals as in [`SlowTensors::residuals`], parameters as in `Parameters::flat`.
/// One row per residual.
pub(crate) fn jacobian(physics: &SlowTensors, network: &RlMlp) -> Result<DMatrix<f64>, PinnError> {
    let (inputs, outputs) = network.activations(physics.features.clone());
    let mut delta = output_delta(physics, outputs);
    let mut blocks = Vec::with_capacity(2 * network.layers.len());
    for (index, (layer, input)) in network.layers.iter().zip(inputs).enumerate().rev() {
        // Both residuals of a slow time see the same activations.
        let input = Tensor::cat(vec![input.clone(), input], 0);
        let [rows, fan_in] = input.dims();
        let [_, fan_out] = delta.dims();
        let outer = input.clone().unsqueeze_dim::<3>(2) * delta.clone().unsqueeze_dim::<3>(1);
        blocks.push(delta.clone());
        blocks.push(outer.reshape([rows, fan_in * fan_out]));
        if index > 0 {
            let back = delta.matmul(layer.weight.clone().transpose());
            // d tanh = 1 - tanh^2, and `input` is that tanh.
            delta = back * (-(input.clone() * input) + 1.0);
        }
    }
    blocks.reverse();
    let all = Tensor::cat(blocks, 1);
    let [rows, columns] = all.dims();
    let values = read(all, physics.backend)?;
    Ok(DMatrix::from_row_slice(rows, columns, &values))
}

/// de/d(outputs before the softplus): `-C * diag(sigmoid)`, R rows above L rows.
fn output_delta(physics: &SlowTensors, outputs: Tensor<2>) -> Tensor<2> {
    // softplus' = 1 / (1 + e^-x); burn's own `sigmoid` is single precision on ndarray.
    let slope = -((-outputs).exp() + 1.0).recip();
    let (r, l) = (slope.clone().narrow(1, 0, 1), slope.narrow(1, 1, 1));
    let r_rows = Tensor::cat(
        vec![
            physics.c_rr.clone() * r.clone(),
            physics.c_rl.clone() * l.clone(),
        ],
        1,
    );
    // L's residual does not depend on R: C is triangular.
    let l_rows = Tensor::cat(vec![r * 0.0, physics.c_ll.clone() * l], 1);
    Tensor::cat(vec![r_rows, l_rows], 0)
}

#[cfg(test)]
mod tests {
    use super::jacobian;
    use crate::Backend;
    use crate::rl_mlp::{RlMlp, read};
    use crate::trial;

    /// d(sum e^2)/dtheta = 2 J^T e must be what burn's reverse mode finds.
    #[test]
    fn the_gradient_from_the_jacobian_is_that_of_burns_autodiff() {
        let (samples, network) = (trial::samples(), trial::network());
        let branch = trial::fitted(&samples);
        let physics = trial::physics(&branch, &samples, &network, &[0, 1], 32);
        let backend = Backend::Ndarray;
        let device = trial::device();
        let plain = physics.on_device(&samples, &network, backend, &device);
        let module = RlMlp::from_parameters(&network, &plain.device);
        let rows = jacobian(&plain, &module).expect("readable");
        let e = plain.evaluate(&network).expect("readable").residuals;
        let by_hand: Vec<f64> = (0..rows.ncols())
            .map(|p| 2.0 * (0..e.len()).map(|k| rows[(k, p)] * e[k]).sum::<f64>())
            .collect();

        let device = device.autodiff();
        let tracked = physics.on_device(&samples, &network, backend, &device);
        let module = RlMlp::from_parameters(&network, &device);
        let residuals = tracked.residuals(&module);
        let gradients = (residuals.clone() * residuals).sum().backward();
        let mut by_burn = Vec::new();
        for layer in &module.layers {
            let weight = layer.weight.grad(&gradients).expect("tracked");
            by_burn.extend(read(weight, backend).expect("readable"));
            let bias = layer.bias.grad(&gradients).expect("tracked");
            by_burn.extend(read(bias, backend).expect("readable"));
        }
        let largest = by_burn.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        assert!(
            largest > 1e-3,
            "the trial network is off, so there is a gradient"
        );
        assert_eq!(by_hand.len(), by_burn.len());
        for (a, b) in by_hand.iter().zip(&by_burn) {
            assert!(
                (a - b).abs() < 1e-10 * largest,
                "{backend}: {a} against {b}"
            );
        }
    }
}
