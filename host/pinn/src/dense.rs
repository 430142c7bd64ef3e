//! A fully connected layer on a burn device: y = x W + b, a row of x a point.
//!
//! Plain tensors with `require_grad` instead of `burn::nn::Linear`: no `Module`, no `Param`, and no
//! generated code for either.

use burn::tensor::module::linear;
use burn::tensor::{DType, Device, Element, Tensor, TensorData};

/// Weights `[input][output]` and biases; where the device differentiates, their gradients are kept.
#[derive(Debug, Clone)]
pub(crate) struct Dense {
    pub weight: Tensor<2>,
    pub bias: Tensor<1>,
}

impl Dense {
    /// Weights row by row, with one bias per output.
    pub fn new<E: Element>(weights: Vec<E>, biases: Vec<E>, device: &Device, dtype: DType) -> Self {
        let outputs = biases.len();
        let shape = [weights.len() / outputs.max(1), outputs];
        let options = (device, dtype);
        Self {
            weight: trained(Tensor::from_data(TensorData::new(weights, shape), options)),
            bias: trained(Tensor::from_data(
                TensorData::new(biases, [outputs]),
                options,
            )),
        }
    }

    /// x W + b.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        linear(x, self.weight.clone(), Some(self.bias.clone()))
    }
}

/// Keeps the gradient if the device has autodiff; `require_grad` panics on one without.
fn trained<const D: usize>(tensor: Tensor<D>) -> Tensor<D> {
    if tensor.is_autodiff() {
        tensor.require_grad()
    } else {
        tensor
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial;

    #[test]
    fn the_gradient_of_the_sum_is_that_of_x_w_plus_b() {
        let plain = trial::device();
        for device in [plain.clone(), plain.autodiff()] {
            let (weights, biases) = (vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], vec![0.5, -0.5]);
            let layer = Dense::new(weights, biases, &device, DType::F64);
            let x = TensorData::new(vec![1.0, -1.0, 2.0], [1, 3]);
            let x = Tensor::from_data(x, (&device, DType::F64));
            let y = layer.forward(x);
            let numbers = |x: Tensor<2>| x.into_data().try_into_vec::<f64>().expect("f64");
            assert_eq!(numbers(y.clone()), [8.5, 9.5]);
            if device.is_autodiff() {
                let gradients = y.sum().backward();
                let by_weight = layer.weight.grad(&gradients).expect("kept");
                assert_eq!(numbers(by_weight), [1.0, 1.0, -1.0, -1.0, 2.0, 2.0]);
                let by_bias = layer.bias.grad(&gradients).expect("kept").unsqueeze();
                assert_eq!(numbers(by_bias), [1.0, 1.0]);
            }
        }
    }
}
