//! The result of the last pass: R(t), L(t) at evenly spaced times, their standard deviations, the losses.

use super::corrected::CorrectedNetwork;
use super::inputs::Inputs;
use super::pass::Pass;
use crate::harmonic_branch::HarmonicBranch;
use crate::optimiser::Descent;
use crate::parameters::Parameters;
use crate::progress::{Log, StopReason};
use crate::result::{Reconstruction, nmse_pct, result_times_s};
use crate::uncertainty::laplace;
use crate::{Identification, LossTerms, PinnError};

/// Curves R(t) and L(t) of a window, by a network or a law.
pub(super) struct Curves {
    /// Times after the first pair, s.
    pub tau_s: Vec<f64>,
    pub r_ohm: Vec<f64>,
    pub l_h: Vec<f64>,
    pub r_sigma_ohm: Vec<f64>,
    pub l_sigma_h: Vec<f64>,
    pub chi2: Vec<f64>,
    /// `w_f L_f`, eq. (4).
    pub physics_loss: f64,
    /// L_i1 and L_i2, eqs. (5) and (6).
    pub data_losses: (f64, f64),
    /// Network to start a later window from.
    pub parameters: Parameters,
    pub stopped: StopReason,
}

/// R(t) and L(t) of the last pass' network; `by_data` is the branch fitted to the data alone.
pub(super) fn of_network(
    pass: &Pass<'_>,
    by_data: &HarmonicBranch,
    descent: Descent,
) -> Result<Curves, PinnError> {
    let (samples, config) = (pass.inputs.samples, pass.inputs.config);
    let tau_s = result_times_s(samples, config);
    let t_s: Vec<f64> = tau_s.iter().map(|tau| samples.t0_s + tau).collect();
    let parameters = descent.parameters;
    let corrected = CorrectedNetwork::new(pass, by_data, &parameters);
    let r_l: Vec<(f64, f64)> = tau_s.iter().map(|tau| corrected.r_l_at(*tau)).collect();
    let strength = pass.prior.strength;
    let sigmas = laplace(&pass.model, &parameters, pass.noise, strength, &t_s)?;
    let mut chi2 = Vec::new();
    let (mut r_sigma_ohm, mut l_sigma_h) =
        sigmas.map_or_else(Default::default, |s| (s.r_ohm, s.l_h));
    let sigmas = r_sigma_ohm.iter_mut().zip(&mut l_sigma_h);
    for ((tau, r_l), (r, l)) in tau_s.iter().zip(&r_l).zip(sigmas) {
        chi2.push(corrected.raise(*tau, *r_l, [r, l]));
    }
    let (r_ohm, l_h) = r_l.into_iter().unzip();
    Ok(Curves {
        tau_s,
        r_ohm,
        l_h,
        r_sigma_ohm,
        l_sigma_h,
        chi2,
        physics_loss: descent.squares + pass.floor,
        data_losses: pass.data_losses,
        parameters,
        stopped: descent.stopped,
    })
}

/// Result of the window whose VI branch is `branch`.
pub(super) fn assemble(
    inputs: &Inputs<'_>,
    branch: &HarmonicBranch,
    curves: Curves,
    log: Log<'_>,
) -> Identification {
    let (samples, config) = (inputs.samples, inputs.config);
    let amplitude = |tau: &f64| branch.amplitude(*tau) * samples.i_max_ampere;
    let power_ratio = |tau: &f64| branch.power_ratio(*tau) / samples.impedance_scale();
    let (l_i1, l_i2) = curves.data_losses;
    Identification {
        impedance_order: inputs.order,
        i_amplitude_a: curves.tau_s.iter().map(amplitude).collect(),
        r_power_ohm: curves.tau_s.iter().map(power_ratio).collect(),
        t_s: curves.tau_s.iter().map(|tau| samples.t0_s + tau).collect(),
        r_ohm: curves.r_ohm,
        l_h: curves.l_h,
        r_sigma_ohm: curves.r_sigma_ohm,
        l_sigma_h: curves.l_sigma_h,
        chi2: curves.chi2,
        // The terms of eq. (7) at the final parameters.
        losses: LossTerms {
            l_f: curves.physics_loss / config.w_f,
            l_i1,
            l_i2,
            total: curves.physics_loss + config.w_i * (l_i1 + l_i2),
        },
        iterations: log.iteration,
        passes: log.pass,
        stopped_because: curves.stopped,
        elapsed_s: log.elapsed_s(),
        nmse_v_pct: nmse_pct(l_i1, &samples.v),
        nmse_i_pct: nmse_pct(l_i2, &samples.i),
        reconstruction: Reconstruction::of_branch(samples, branch),
        history: log.history,
        parameters: curves.parameters,
    }
}
