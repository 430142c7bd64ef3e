//! The physics residuals as a function of the RL-MLP: by own code, or in burn tensors.

use crate::PinnError;
use crate::jacobian::jacobian;
use crate::loss::{SlowPhysics, SlowTensors};
use crate::output_jacobian::output_rows;
use crate::parameters::Parameters;
use crate::rl_mlp::{RlMlp, read};
use crate::waveform::Normalised;

/// Residuals e of [`SlowPhysics`] with all that an optimiser asks for.
pub(crate) enum SlowModel {
    /// Plain double precision.
    Own {
        physics: SlowPhysics,
        /// The RL-MLP's inputs at each slow time.
        features: Vec<Vec<f64>>,
    },
    /// On a burn device; with autodiff where gradients are asked for.
    Burn(Box<SlowTensors>),
}

/// Squared residuals, their gradient, and the network's outputs.
pub(crate) struct Descending {
    pub squares: f64,
    pub outputs: Vec<f64>,
    pub gradient: Vec<f64>,
}

impl SlowModel {
    /// Own code for these slow times.
    pub fn own(physics: &SlowPhysics, samples: &Normalised, parameters: &Parameters) -> Self {
        let at = |tau: &f64| {
            parameters
                .embedding
                .features(samples.t0_s + tau, samples.f_mains_hz)
        };
        Self::Own {
            features: physics.tau_s.iter().map(at).collect(),
            physics: physics.clone(),
        }
    }

    /// The residuals (R rows of all slow times, then L rows) and the network's outputs (R, L
    /// alternating).
    pub fn evaluate(&self, parameters: &Parameters) -> Result<(Vec<f64>, Vec<f64>), PinnError> {
        match self {
            Self::Own { physics, features } => {
                let y: Vec<_> = features.iter().map(|f| parameters.outputs(f)).collect();
                Ok((physics.residuals(&y), y.concat()))
            }
            Self::Burn(tensors) => tensors.evaluate(parameters),
        }
    }

    /// de/dtheta row by row, parameters as in `Parameters::flat`.
    pub fn jacobian(&self, parameters: &Parameters) -> Result<Vec<f64>, PinnError> {
        match self {
            Self::Own { physics, features } => {
                let rows = features.iter().map(|f| output_rows(parameters, f));
                Ok(physics.residual_rows(&rows.collect::<Vec<_>>()))
            }
            Self::Burn(tensors) => jacobian(
                tensors,
                &RlMlp::from_parameters(parameters, &tensors.device),
            ),
        }
    }

    /// The squared residuals and their gradient: by burn's reverse mode on a burn backend, `2 J^T e`
    /// else.
    pub fn descending(&self, parameters: &Parameters) -> Result<Descending, PinnError> {
        match self {
            Self::Own { .. } => {
                let (e, outputs) = self.evaluate(parameters)?;
                let rows = self.jacobian(parameters)?;
                let mut gradient = vec![0.0; parameters.flat_len()];
                for (row, e) in rows.chunks_exact(gradient.len()).zip(&e) {
                    for (g, d) in gradient.iter_mut().zip(row) {
                        *g += 2.0 * d * e;
                    }
                }
                Ok(Descending {
                    squares: e.iter().map(|e| e * e).sum(),
                    outputs,
                    gradient,
                })
            }
            Self::Burn(tensors) => by_burn(tensors, parameters),
        }
    }
}

fn by_burn(tensors: &SlowTensors, parameters: &Parameters) -> Result<Descending, PinnError> {
    let network = RlMlp::from_parameters(parameters, &tensors.device);
    let e = tensors.residuals(&network);
    let squares = (e.clone() * e).sum();
    let gradients = squares.backward();
    let mut gradient = Vec::with_capacity(parameters.flat_len());
    for layer in &network.layers {
        let tracked = |found: Option<Vec<f64>>| {
            found.ok_or_else(|| PinnError::Backend {
                backend: tensors.backend.to_string(),
                detail: "a parameter has no gradient".to_owned(),
            })
        };
        let weights = layer.weight.grad(&gradients);
        let weights = weights.map(|g| read(g, tensors.backend)).transpose()?;
        gradient.extend(tracked(weights)?);
        let biases = layer.bias.grad(&gradients);
        let biases = biases.map(|g| read(g, tensors.backend)).transpose()?;
        gradient.extend(tracked(biases)?);
    }
    let outputs = read(network.forward(tensors.features.clone()), tensors.backend)?;
    Ok(Descending {
        squares: read(squares, tensors.backend)?[0],
        outputs,
        gradient,
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
        for backend in [Backend::Flex, Backend::Ndarray] {
            let device = backend.device().expect("a burn backend").autodiff();
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
            let (e, y) = own.evaluate(&network).expect("own");
            let (e_burn, y_burn) = burn.evaluate(&network).expect("readable");
            close(&e, &e_burn);
            close(&y, &y_burn);
            let rows = own.jacobian(&network).expect("own");
            close(&rows, &burn.jacobian(&network).expect("readable"));
            let (a, b) = (own.descending(&network), burn.descending(&network));
            let (a, b) = (a.expect("own"), b.expect("readable"));
            close(&a.gradient, &b.gradient);
            close(&[a.squares], &[b.squares]);
        }
    }
}
