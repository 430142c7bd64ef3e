//! The physics residuals e of eq. (4), condensed ([`SlowPhysics`]), as a function of the RL-MLP: e, ∂e/∂θ and
//! d|e|²/dθ, by own code or in burn tensors.

use crate::derivatives::Derivatives;
use crate::jacobian::jacobian;
use crate::levenberg_marquardt::Evaluation;
use crate::loss::{SlowPhysics, SlowTensors};
use crate::own_network::OwnNetwork;
use crate::parameters::{OUTPUTS, Parameters};
use crate::rl_mlp::{RlMlp, read};
use crate::waveform::NormalisedWaveform;
use crate::{Optimiser, PinnConfig, PinnError};

/// Residuals e of [`SlowPhysics`] with all functions that an optimiser needs.
pub(crate) enum SlowModel {
    /// Own code in double precision.
    Own {
        physics: SlowPhysics,
        /// RL-MLP at each slow time.
        network: OwnNetwork,
        /// Derivatives of the residuals by the network's outputs.
        factors: Box<[[Vec<f64>; OUTPUTS]; OUTPUTS]>,
    },
    /// burn on a device, with autodiff if gradients are needed.
    Burn(Box<SlowTensors>),
}

/// Gradient of the squared residuals, with residuals and outputs.
pub(crate) struct Gradient {
    /// |e|².
    pub squares: f64,
    /// R / r_scale, L / l_scale alternating.
    pub outputs: Vec<f64>,
    /// d|e|²/dθ.
    pub values: Vec<f64>,
}

impl SlowModel {
    /// Creates the model on the configured backend, with autodiff if the optimiser needs it.
    pub fn new(
        physics: &SlowPhysics,
        samples: &NormalisedWaveform,
        parameters: &Parameters,
        config: &PinnConfig,
    ) -> Result<Self, PinnError> {
        let Some(device) = config.backend.device()? else {
            return Ok(Self::own(physics, samples, parameters));
        };
        let device = match config.optimiser {
            Optimiser::LevenbergMarquardt => device,
            Optimiser::Adam => device.autodiff(),
        };
        let tensors = physics.on_device(samples, parameters, config.backend, &device);
        Ok(Self::Burn(Box::new(tensors)))
    }

    /// Creates the model in own code.
    pub fn own(
        physics: &SlowPhysics,
        samples: &NormalisedWaveform,
        parameters: &Parameters,
    ) -> Self {
        let t_s = physics.tau_s.iter().map(|tau| samples.t0_s + tau);
        Self::Own {
            network: OwnNetwork::at(parameters, t_s),
            factors: Box::new(physics.factors()),
            physics: physics.clone(),
        }
    }

    /// The residuals: R rows of all slow times, then L rows; the outputs: R / r_scale, L / l_scale alternating.
    pub fn evaluate(&self, parameters: &Parameters) -> Result<Evaluation, PinnError> {
        match self {
            Self::Own {
                physics, network, ..
            } => {
                let y = network.forward(parameters).outputs();
                Ok(Evaluation {
                    residuals: physics.residuals(&y),
                    outputs: y.concat(),
                })
            }
            Self::Burn(tensors) => tensors.evaluate(parameters),
        }
    }

    /// de/dtheta, one row per residual, parameters as in `Parameters::flat`.
    pub fn jacobian(&self, parameters: &Parameters) -> Result<Derivatives, PinnError> {
        match self {
            Self::Own {
                network, factors, ..
            } => {
                let at = network.forward(parameters);
                let by_all = at.derivatives(parameters, factors.as_slice());
                Ok(Derivatives::OfNetwork(by_all))
            }
            Self::Burn(tensors) => {
                let network = RlMlp::from_parameters(parameters, &tensors.device);
                jacobian(tensors, &network).map(Derivatives::Matrix)
            }
        }
    }

    /// Squared residuals and their gradient: by reverse mode on a burn backend, else
    /// `2 J^T e`.
    pub fn gradient(&self, parameters: &Parameters) -> Result<Gradient, PinnError> {
        match self {
            Self::Own { .. } => {
                let at = self.evaluate(parameters)?;
                let jacobian = self.jacobian(parameters)?;
                let values = 2.0 * jacobian.transposed_times(&at.residuals);
                let values = values.as_slice().to_vec();
                Ok(Gradient {
                    squares: at.squares(),
                    outputs: at.outputs,
                    values,
                })
            }
            Self::Burn(tensors) => by_burn(tensors, parameters),
        }
    }
}

fn by_burn(tensors: &SlowTensors, parameters: &Parameters) -> Result<Gradient, PinnError> {
    let network = RlMlp::from_parameters(parameters, &tensors.device);
    let e = tensors.residuals(&network);
    let squares = (e.clone() * e).sum();
    let gradients = squares.backward();
    let mut values = Vec::with_capacity(parameters.flat_len());
    for layer in &network.layers {
        let tracked = |gradient: Option<Vec<f64>>| {
            gradient.ok_or_else(|| PinnError::Backend {
                backend: tensors.backend.to_string(),
                detail: "a parameter has no gradient".to_owned(),
            })
        };
        let weights = layer.weight.grad(&gradients);
        let weights = weights.map(|g| read(g, tensors.backend)).transpose()?;
        values.extend(tracked(weights)?);
        let biases = layer.bias.grad(&gradients);
        let biases = biases.map(|g| read(g, tensors.backend)).transpose()?;
        values.extend(tracked(biases)?);
    }
    let outputs = read(network.forward(tensors.features.clone()), tensors.backend)?;
    Ok(Gradient {
        squares: read(squares, tensors.backend)?[0],
        outputs,
        values,
    })
}

#[cfg(test)]
mod tests {
    use super::SlowModel;
    use crate::Backend;
    use crate::trial;

    #[test]
    fn own_code_and_burn_are_one_function_with_one_jacobian_and_one_gradient() {
        let (samples, network) = (trial::samples(), trial::network());
        let branch = trial::fitted(&samples);
        let physics = trial::physics(&branch, &samples, &network, &[0, 1], 32);
        let own = SlowModel::own(&physics, &samples, &network);
        let backend = Backend::Ndarray;
        let device = trial::device().autodiff();
        let tensors = physics.on_device(&samples, &network, backend, &device);
        let burn = SlowModel::Burn(Box::new(tensors));
        let close = |a: &[f64], b: &[f64]| {
            let largest = a.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            assert!(largest > 1e-3 && a.len() == b.len());
            for (a, b) in a.iter().zip(b) {
                assert!(
                    (a - b).abs() < 1e-10 * largest,
                    "{backend}: {a} against {b}"
                );
            }
        };
        let at = own.evaluate(&network).expect("own");
        let at_burn = burn.evaluate(&network).expect("readable");
        close(&at.residuals, &at_burn.residuals);
        close(&at.outputs, &at_burn.outputs);
        let rows = own.jacobian(&network).expect("own");
        let of_burn = burn.jacobian(&network).expect("readable");
        assert_eq!(rows.shape(), of_burn.shape());
        close(rows.dense().as_slice(), of_burn.dense().as_slice());
        let (a, b) = (own.gradient(&network), burn.gradient(&network));
        let (a, b) = (a.expect("own"), b.expect("readable"));
        close(&a.values, &b.values);
        close(&[a.squares], &[b.squares]);
    }
}
