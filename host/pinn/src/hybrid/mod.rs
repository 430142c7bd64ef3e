//! Minimises the paper's eq. (7),
//!
//!   L = w_f L_f + w_i (L_i1 + L_i2),
//!
//! by block-coordinate descent: the harmonic VI branch by linear least squares, with R(t) and L(t) held; then
//! the RL-MLP by the configured optimiser, with the branch held; alternating. The first branch is fitted to
//! the data terms (5), (6) alone; where noise is below the tolerance it is also the last. With `at_once` a law that was
//! learned from simulated loads comes first, and the network only where that does not hold.

mod corrected;
mod inputs;
pub(crate) mod law;
mod misfit;
mod pass;
mod result;
mod setup;

use self::inputs::Inputs;
use self::law::LawWindow;
use self::pass::Pass;
use crate::progress::Log;
use crate::vi_system::{DataSystem, PhysicsTerm};
use crate::waveform::NormalisedWaveform;
use crate::{Identification, PinnConfig, PinnError};

/// Identifies R(t) and L(t) of one window.
pub(crate) fn hybrid(
    samples: &NormalisedWaveform,
    config: &PinnConfig,
    mut log: Log<'_>,
) -> Result<Identification, PinnError> {
    let system = DataSystem::assemble(samples, setup::harmonic_basis(samples, config)?);
    let by_data = system.fit()?;
    let mut branch = by_data.clone();
    let mut network = setup::network_outline(samples, config);
    let order = setup::impedance_order(&branch, samples, &network, config);
    let inputs = Inputs {
        samples,
        config,
        system: &system,
        order,
        laws: setup::laws(order, &branch.basis, config),
    };
    if config.at_once
        && let Some(curves) = LawWindow::new(&inputs, &by_data, &network).curves()
    {
        log.pass = 1;
        return Ok(result::assemble(&inputs, &by_data, curves, log));
    }
    loop {
        log.pass += 1;
        let pass = Pass::new(&inputs, &branch, network)?;
        let descent = pass.train(&mut log)?;
        let unchanged = log.pass > 1 && pass.change_to(&descent.parameters) < pass.tolerance;
        let converged = pass.is_quiet || unchanged;
        if converged || log.pass >= config.outer_passes || !descent.stopped.is_converged() {
            let curves = result::of_network(&pass, &by_data, descent)?;
            return Ok(result::assemble(&inputs, &branch, curves, log));
        }
        network = descent.parameters;
        branch = system.fit_with_physics(&PhysicsTerm {
            weight: config.w_f / config.w_i,
            impedance: &pass.impedances(&network),
            harmonics: &inputs.laws,
        })?;
    }
}
