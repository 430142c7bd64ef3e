//! Eq. (7) of both networks in burn tensors: the gradient by burn's reverse mode, d/dt as a tangent
//! beside the values, since burn has no forward mode.

use std::ops::Range;

use burn::tensor::activation::softplus;
use burn::tensor::{DType, Device, Tensor, TensorData};

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

/// The points of a batch as tensors, a row a point.
#[derive(Debug, Clone)]
struct Batch {
    fast: Tensor<2>,
    fast_rate: Tensor<2>,
    slow: Tensor<2>,
    v: Tensor<2>,
    i: Tensor<2>,
}

/// Outputs of both networks and the tangent of i, a column each.
struct Outputs {
    v: Tensor<2>,
    i: Tensor<2>,
    i_rate: Tensor<2>,
    r: Tensor<2>,
    x: Tensor<2>,
}

/// burn on one of its devices.
pub(crate) struct Burn {
    backend: Backend,
    device: Device,
    dtype: DType,
    /// The last batch: with full batches, every one.
    batch: Option<(Range<usize>, Batch)>,
}

impl Burn {
    /// In single precision on `device`, which stands for `backend`.
    pub fn new(backend: Backend, device: Device) -> Self {
        Self {
            backend,
            device: device.autodiff(),
            dtype: DType::F32,
            batch: None,
        }
    }

    /// The same in double precision.
    #[cfg(test)]
    pub fn double(backend: Backend, device: Device) -> Self {
        Self {
            dtype: DType::F64,
            ..Self::new(backend, device)
        }
    }

    fn matrix(&self, values: &[f32], width: usize) -> Tensor<2> {
        let shape = [values.len() / width.max(1), width];
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
            self.matrix(&values[range.start * width..range.end * width], width)
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

    fn scalar(&self, tensor: Tensor<1>) -> Result<f64, PinnError> {
        let values = self.read(tensor)?;
        Ok(f64::from(values.first().copied().unwrap_or(f32::NAN)))
    }
}

impl Networks {
    fn outputs(&self, batch: &Batch, problem: &Problem<'_>) -> Outputs {
        let (mut x, mut rate) = (batch.fast.clone(), batch.fast_rate.clone());
        for (index, layer) in self.vi.iter().enumerate() {
            x = layer.forward(x);
            rate = rate.matmul(layer.weight.clone());
            if index + 1 < self.vi.len() {
                rate = rate * x.clone().cos();
                x = x.sin();
            }
        }
        let mut y = batch.slow.clone();
        for (index, layer) in self.rl.iter().enumerate() {
            y = layer.forward(y);
            if index + 1 < self.rl.len() {
                y = y.tanh();
            }
        }
        let y = softplus(y, 1.0);
        let column = |x: &Tensor<2>, at| x.clone().narrow(1, at, 1);
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
        let mean = |e: Tensor<2>| (e.clone() * e).mean();
        let l_f =
            mean(outputs.v.clone() - outputs.r * outputs.i.clone() - outputs.x * outputs.i_rate);
        let l_i1 = mean(outputs.v - batch.v);
        let l_i2 = mean(outputs.i - batch.i);
        let data = l_i1.clone() + l_i2.clone();
        let total = l_f.clone() * weights.w_f + data * weights.w_i;
        let found = total.backward();
        let layers = networks.vi.iter().chain(&networks.rl);
        for (place, layer) in problem.shape.layers().zip(layers) {
            // A parameter that the loss does not depend on has no gradient: zero.
            gradient[place.weights.start..place.biases.end].fill(0.0);
            if let Some(by_weight) = layer.weight.grad(&found) {
                gradient[place.weights.clone()].copy_from_slice(&self.read(by_weight)?);
            }
            if let Some(by_bias) = layer.bias.grad(&found) {
                gradient[place.biases.clone()].copy_from_slice(&self.read(by_bias)?);
            }
        }
        Ok(Terms {
            l_f: self.scalar(l_f)?,
            l_i1: self.scalar(l_i1)?,
            l_i2: self.scalar(l_i2)?,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SlowEmbedding;
    use crate::networks::collocation::{Collocation, Impedances};
    use crate::networks::fused::Fused;
    use crate::networks::shape::Shape;
    use crate::trial;
    use crate::vi_mlp::ViMlp;

    const WEIGHTS: Weights = Weights { w_f: 5.0, w_i: 1.0 };

    /// 183 points, so that blocks and tiles have remainders; hidden widths likewise.
    fn trial_problem(vi: &ViMlp, slow: SlowEmbedding) -> (Shape, Collocation, Impedances) {
        let samples = trial::samples();
        let points = Collocation::new(&samples, vi, &slow, 1);
        let shape = Shape::new(
            (vi.width(), &vi.hidden_layers),
            (slow.width(), &[16, 16, 16, 16]),
        );
        (shape, points, Impedances { r: 0.7, x: 0.9 })
    }

    fn assert_close(a: &[f32], b: &[f32], tolerance: f32, what: &str) {
        let largest = b.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
        assert!(largest > 1e-2 && a.len() == b.len());
        for (at, (a, b)) in a.iter().zip(b).enumerate() {
            assert!(
                (a - b).abs() < tolerance * largest,
                "{what} {at}: {a} against {b}"
            );
        }
    }

    #[test]
    fn fused_flex_and_ndarray_give_one_loss_and_one_gradient_to_rounding() {
        for (hidden_layers, slow) in [
            (vec![64; 3], SlowEmbedding::Symmetric),
            (vec![20, 7], SlowEmbedding::Fourier { first: 1, count: 1 }),
        ] {
            let vi = ViMlp {
                hidden_layers,
                downsampling: 50,
                ..ViMlp::default()
            };
            let (shape, points, impedances) = trial_problem(&vi, slow);
            let problem = Problem {
                shape: &shape,
                points: &points,
                impedances,
            };
            let theta = shape.xavier(5);
            let evaluate = |kernel: &mut dyn Kernel| {
                let mut gradient = vec![0.0; shape.len];
                let terms = kernel.loss(&problem, &theta, 0..points.len(), WEIGHTS, &mut gradient);
                (terms.expect("computes"), gradient)
            };
            let (terms, gradient) = evaluate(&mut Fused::new(&shape));
            for backend in [Backend::Flex, Backend::Ndarray] {
                let device = backend.device().expect("a burn backend");
                let (by_burn, burns) = evaluate(&mut Burn::new(backend, device));
                assert_close(&gradient, &burns, 2e-5, "gradient");
                let ours = [terms.l_f, terms.l_i1, terms.l_i2];
                for (a, b) in ours.iter().zip([by_burn.l_f, by_burn.l_i1, by_burn.l_i2]) {
                    assert!((a / b - 1.0).abs() < 1e-5, "{a} against {b}");
                }
            }
            let mut fused = Fused::new(&shape);
            let mut burn = Burn::new(Backend::Flex, Backend::Flex.device().expect("flex"));
            let (v, i) = fused.signals(&problem, &theta).expect("computes");
            let (v_burn, i_burn) = burn.signals(&problem, &theta).expect("computes");
            assert_close(&v, &v_burn, 1e-5, "v");
            assert_close(&i, &i_burn, 1e-5, "i");
        }
    }

    #[test]
    fn the_gradient_is_the_finite_difference_of_burns_loss_in_double_precision() {
        let vi = ViMlp {
            hidden_layers: vec![12, 9],
            downsampling: 50,
            ..ViMlp::default()
        };
        let (shape, points, impedances) = trial_problem(&vi, SlowEmbedding::Symmetric);
        let problem = Problem {
            shape: &shape,
            points: &points,
            impedances,
        };
        let theta = shape.xavier(2);
        let mut gradient = vec![0.0; shape.len];
        let all = 0..points.len();
        let mut fused = Fused::new(&shape);
        let computed = fused.loss(&problem, &theta, all.clone(), WEIGHTS, &mut gradient);
        computed.expect("computes");
        let mut burn = Burn::double(Backend::Flex, Backend::Flex.device().expect("flex"));
        let largest = gradient.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
        let mut unused = vec![0.0; shape.len];
        for p in (0..shape.len).step_by(13) {
            let mut total_at = |value: f32| {
                let mut moved = theta.clone();
                moved[p] = value;
                let terms = burn.loss(&problem, &moved, all.clone(), WEIGHTS, &mut unused);
                terms.expect("computes").total(WEIGHTS)
            };
            // The step as f32 has it; the loss is read back in single precision, so it is large.
            let (up, down) = (theta[p] + 1e-2, theta[p] - 1e-2);
            let numeric = (total_at(up) - total_at(down)) / f64::from(up - down);
            let error = (numeric - f64::from(gradient[p])).abs();
            assert!(
                error < 2e-3 * f64::from(largest),
                "{p}: {numeric} {}",
                gradient[p]
            );
        }
    }

    #[test]
    fn the_tangent_of_the_network_is_its_finite_difference_in_double_precision() {
        let vi = ViMlp {
            downsampling: 50,
            ..ViMlp::default()
        };
        let (shape, points, impedances) = trial_problem(&vi, SlowEmbedding::Symmetric);
        let problem = Problem {
            shape: &shape,
            points: &points,
            impedances,
        };
        let burn = Burn::double(Backend::Flex, Backend::Flex.device().expect("flex"));
        let networks = burn.networks(&problem, &shape.xavier(9));
        let wide = |values: Vec<f64>, width: usize| -> Tensor<2> {
            let shape = [values.len() / width, width];
            Tensor::from_data(TensorData::new(values, shape), (&burn.device, DType::F64))
        };
        let (f_sw_hz, step) = (45e3, 1e-5);
        let per_radian_s = (std::f64::consts::TAU * f_sw_hz).recip();
        for t_s in [1.234_5e-3, 5.5e-3] {
            let at = |shift: f64| {
                let (x, rate) = vi.features(t_s + shift * per_radian_s, f_sw_hz, 50.0);
                let batch = Batch {
                    fast: wide(x, vi.width()),
                    fast_rate: wide(rate, vi.width()),
                    slow: wide(vec![0.1, 0.2], 2),
                    v: wide(vec![0.0], 1),
                    i: wide(vec![0.0], 1),
                };
                let outputs = networks.outputs(&batch, &problem);
                let number = |x: Tensor<2>| x.into_data().try_into_vec::<f64>().expect("f64")[0];
                (number(outputs.i), number(outputs.i_rate))
            };
            let numeric = (at(step).0 - at(-step).0) / (2.0 * step);
            let (_, exact) = at(0.0);
            assert!(
                (numeric - exact).abs() < 1e-8 * (1.0 + exact.abs()),
                "{numeric} {exact}"
            );
        }
    }
}
