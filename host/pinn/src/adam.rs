//! Adam on the physics residuals of the RL-MLP: the paper's optimiser, to compare with.

use burn::optim::{AdamConfig, GradientsParams};

use crate::PinnError;
use crate::levenberg_marquardt::Descent;
use crate::loss::SlowTensors;
use crate::parameters::Parameters;
use crate::progress::{Log, Settling, StoppedBecause};
use crate::rl_mlp::{RlMlp, read};

/// Steps over which R and L must rest: single steps of Adam are small.
const SETTLING_STEPS: usize = 200;

/// Minimises the residuals of `physics` from `parameters` on by gradient steps; the best
/// parameters seen are the result, since Adam does not descend at every step.
///
/// `physics` must live on an autodiff device.
pub(crate) fn descend(
    physics: &SlowTensors,
    parameters: Parameters,
    learning_rate: f64,
    tolerance: f64,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    let mut network = RlMlp::from_parameters(&parameters, &physics.device);
    // The loss is far below 1 in its units; burn's 1e-5 would swallow the gradient.
    let mut optimiser = AdamConfig::new().with_epsilon(1e-12).init();
    let mut settling = Settling::over(SETTLING_STEPS);
    let mut best = Descent {
        parameters,
        squares: f64::INFINITY,
        stopped: StoppedBecause::RolledBack,
    };
    loop {
        let e = physics.residuals(&network);
        let loss = (e.clone() * e).sum();
        let squares = read(loss.clone(), physics.backend)?[0];
        if !squares.is_finite() {
            best.stopped = StoppedBecause::RolledBack;
            return Ok(best);
        }
        if squares < best.squares {
            best.parameters = network.to_parameters(&best.parameters, physics.backend)?;
            best.squares = squares;
        }
        if let Some(limit) = log.exhausted() {
            best.stopped = limit;
            return Ok(best);
        }
        let outputs = network.forward(physics.features.clone());
        let change = settling.change(read(outputs, physics.backend)?);
        log.record(squares, change);
        if change < tolerance {
            best.stopped = StoppedBecause::Settled;
            return Ok(best);
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        network = optimiser.step(learning_rate, network, gradients);
    }
}
