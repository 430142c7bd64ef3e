//! The RL-MLP in burn tensors (paper section II, outputs scaled): slow features, eq. (3), in, R and L in
//! units of their scales out.

use burn::tensor::activation::{softplus, tanh};
use burn::tensor::{DType, Device, Tensor, TensorData};

use crate::PinnError;
use crate::backend::Backend;
use crate::dense::Dense;
use crate::parameters::Parameters;

/// Multilayer perceptron with tanh hidden layers and softplus outputs.
///
/// The softplus works on R and L over their scales (see [`crate::PinnConfig`]): on SI-scaled L its
/// argument would have to reach -11, where its slope of 2e-5 stops any training.
#[derive(Debug)]
pub(crate) struct RlMlp {
    pub layers: Vec<Dense>,
}

impl RlMlp {
    /// Creates the network with these weights, in double precision.
    pub fn from_parameters(parameters: &Parameters, device: &Device) -> Self {
        let layers = parameters.layers.iter().map(|layer| {
            let (weights, biases) = (layer.weights.clone(), layer.biases.clone());
            Dense::new(weights, biases, device, DType::F64)
        });
        Self {
            layers: layers.collect(),
        }
    }

    /// R / r_scale and L / l_scale, one row per row of `features`.
    pub fn forward(&self, features: Tensor<2>) -> Tensor<2> {
        softplus(self.activations(features).1, 1.0)
    }

    /// The input of every layer, and the outputs before the softplus.
    pub fn activations(&self, features: Tensor<2>) -> (Vec<Tensor<2>>, Tensor<2>) {
        let mut inputs = Vec::with_capacity(self.layers.len());
        let mut x = features;
        for (index, layer) in self.layers.iter().enumerate() {
            inputs.push(x.clone());
            x = layer.forward(x);
            if index + 1 < self.layers.len() {
                x = tanh(x);
            }
        }
        (inputs, x)
    }
}

/// A double-precision tensor from numbers in row order.
pub(crate) fn matrix(values: Vec<f64>, shape: [usize; 2], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values, shape), (device, DType::F64))
}

/// The tensor's numbers in row order.
pub(crate) fn read<const D: usize>(
    tensor: Tensor<D>,
    backend: Backend,
) -> Result<Vec<f64>, PinnError> {
    let broken = |detail: String| PinnError::Backend {
        backend: backend.to_string(),
        detail,
    };
    tensor
        .try_into_data()
        .map_err(|e| broken(e.to_string()))?
        .try_into_vec::<f64>()
        .map_err(|e| broken(format!("{e:?}")))
}
