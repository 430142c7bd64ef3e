//! Eq. (7) of both networks in burn tensors: the gradient by burn's reverse mode, d/dt as a tangent
//! beside the values, since burn has no forward mode.

#[cfg(test)]
mod tests;

use std::ops::Range;

use burn::tensor::activation::softplus;
use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};

use super::kernel::{Kernel, Problem, Terms, Weights};
use super::shape::LayerPlace;
use crate::dense::Dense;
use crate::{Backend, PinnError};

/// VI-MLP (sine) and RL-MLP (hyperbolic tangent, softplus).
#[derive(Debug)]
struct Networks {
    vi: Vec<Dense>,
    rl: Vec<Dense>,
}

/// Points of a batch as tensors, a row each, in groups: a layer's gradient is a sum over all rows, which a GPU takes in parallel for the
/// groups alone.
#[derive(Debug, Clone)]
struct Batch {
    fast: Tensor<3>,
    fast_rate: Tensor<3>,
    slow: Tensor<3>,
    v: Tensor<3>,
    i: Tensor<3>,
}

/// Outputs of both networks and the tangent of i, one column each.
struct Outputs {
    v: Tensor<3>,
    i: Tensor<3>,
    i_rate: Tensor<3>,
    r: Tensor<3>,
    x: Tensor<3>,
}

/// burn on one of its devices.
pub(crate) struct Burn {
    backend: Backend,
    device: Device,
    dtype: DType,
    /// Last batch; with full batches, the only one.
    batch: Option<(Range<usize>, Batch)>,
}

impl Burn {
    /// Creates the kernel in single precision on `device`, which belongs to `backend`.
    pub fn new(backend: Backend, device: Device) -> Self {
        Self {
            backend,
            device: device.autodiff(),
            dtype: DType::F32,
            batch: None,
        }
    }

    /// Creates the kernel in double precision.
    #[cfg(test)]
    pub fn double(backend: Backend, device: Device) -> Self {
        Self {
            dtype: DType::F64,
            ..Self::new(backend, device)
        }
    }

    fn rows(&self, values: &[f32], width: usize) -> Tensor<3> {
        let rows = values.len() / width.max(1);
        let groups = groups_of(rows);
        let shape = [groups, rows / groups, width];
        Tensor::from_data(
            TensorData::new(values.to_vec(), shape),
            (&self.device, self.dtype),
        )
    }

    fn networks(&self, problem: &Problem<'_>, theta: &[f32]) -> Networks {
        let dense = |place: &LayerPlace| {
            let (weights, biases) = (&theta[place.weights.clone()], &theta[place.biases.clone()]);
            Dense::new(weights.to_vec(), biases.to_vec(), &self.device, self.dtype)
        };
        let layers = |places: &[LayerPlace]| places.iter().map(dense).collect();
        Networks {
            vi: layers(&problem.shape.vi),
            rl: layers(&problem.shape.rl),
        }
    }

    fn batch(&mut self, problem: &Problem<'_>, range: &Range<usize>) -> Batch {
        if let Some((cached, batch)) = &self.batch
            && cached == range
        {
            return batch.clone();
        }
        let points = problem.points;
        let rows = |values: &[f32], width: usize| {
            self.rows(&values[range.start * width..range.end * width], width)
        };
        let batch = Batch {
            fast: rows(&points.fast, points.fast_width),
            fast_rate: rows(&points.fast_rate, points.fast_width),
            slow: rows(&points.slow, points.slow_width),
            v: rows(&points.v, 1),
            i: rows(&points.i, 1),
        };
        self.batch = Some((range.clone(), batch.clone()));
        batch
    }

    fn read<const D: usize>(&self, tensor: Tensor<D>) -> Result<Vec<f32>, PinnError> {
        let broken = |detail: String| PinnError::Backend {
            backend: self.backend.to_string(),
            detail,
        };
        tensor
            .try_into_data()
            .map_err(|e| broken(e.to_string()))?
            .convert::<f32>()
            .try_into_vec::<f32>()
            .map_err(|e| broken(format!("{e:?}")))
    }
}

/// Most groups of rows: as many blocks as keep a large GPU busy.
const MAX_GROUPS: usize = 256;

/// Largest number of equal groups of so many rows.
fn groups_of(rows: usize) -> usize {
    let divides = |groups: &usize| rows.is_multiple_of(*groups);
    (1..=MAX_GROUPS).rev().find(divides).unwrap_or(1)
}

/// x W + b, not as `Dense::forward`, which joins the groups.
fn forward(layer: &Dense, x: Tensor<3>) -> Tensor<3> {
    x.matmul(layer.weight.clone().unsqueeze()) + layer.bias.clone().unsqueeze()
}

/// Gradient of the loss by `parameter`, row by row; zero for one that the loss does not depend on.
fn gradient_by<const D: usize>(parameter: &Tensor<D>, gradients: &Gradients) -> Tensor<1> {
    let gradient = parameter.grad(gradients);
    let gradient = gradient.unwrap_or_else(|| parameter.clone().inner().zeros_like());
    gradient.flatten(0, D - 1)
}

impl Networks {
    fn outputs(&self, batch: &Batch, problem: &Problem<'_>) -> Outputs {
        let (mut x, mut rate) = (batch.fast.clone(), batch.fast_rate.clone());
        for (index, layer) in self.vi.iter().enumerate() {
            x = forward(layer, x);
            rate = rate.matmul(layer.weight.clone().unsqueeze());
            if index + 1 < self.vi.len() {
                rate = rate * x.clone().cos();
                x = x.sin();
            }
        }
        let mut y = batch.slow.clone();
        for (index, layer) in self.rl.iter().enumerate() {
            y = forward(layer, y);
            if index + 1 < self.rl.len() {
                y = y.tanh();
            }
        }
        let y = softplus(y, 1.0);
        let column = |x: &Tensor<3>, at| x.clone().narrow(2, at, 1);
        Outputs {
            v: column(&x, 0),
            i: column(&x, 1),
            i_rate: column(&rate, 1),
            r: column(&y, 0) * problem.impedances.r,
            x: column(&y, 1) * problem.impedances.x,
        }
    }
}

impl Kernel for Burn {
    fn loss(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
        batch: Range<usize>,
        weights: Weights,
        gradient: &mut [f32],
    ) -> Result<Terms, PinnError> {
        let networks = self.networks(problem, theta);
        let batch = self.batch(problem, &batch);
        let outputs = networks.outputs(&batch, problem);
        let mean = |e: Tensor<3>| (e.clone() * e).mean();
        let l_f =
            mean(outputs.v.clone() - outputs.r * outputs.i.clone() - outputs.x * outputs.i_rate);
        let l_i1 = mean(outputs.v - batch.v);
        let l_i2 = mean(outputs.i - batch.i);
        let data = l_i1.clone() + l_i2.clone();
        let total = l_f.clone() * weights.w_f + data * weights.w_i;
        let gradients = total.backward();
        let layers = networks.vi.iter().chain(&networks.rl);
        let layers = layers.flat_map(|layer| {
            [
                gradient_by(&layer.weight, &gradients),
                gradient_by(&layer.bias, &gradients),
            ]
        });
        // Terms and gradient are read in one piece: each reading waits for the device.
        let terms = [l_f, l_i1, l_i2].map(Tensor::inner);
        let values = self.read(Tensor::cat(terms.into_iter().chain(layers).collect(), 0))?;
        let (terms, mut rest) = values.split_at(3);
        for place in problem.shape.layers() {
            let own;
            (own, rest) = rest.split_at(place.biases.end - place.weights.start);
            gradient[place.weights.start..place.biases.end].copy_from_slice(own);
        }
        let term = |at: usize| f64::from(terms[at]);
        Ok(Terms {
            l_f: term(0),
            l_i1: term(1),
            l_i2: term(2),
        })
    }

    fn signals(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), PinnError> {
        let networks = self.networks(problem, theta);
        let batch = self.batch(problem, &(0..problem.points.len()));
        let outputs = networks.outputs(&batch, problem);
        Ok((self.read(outputs.v)?, self.read(outputs.i)?))
    }
}
