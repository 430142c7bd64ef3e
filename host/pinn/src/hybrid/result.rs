//! The result of the last pass: R(t), L(t) at evenly spaced times, their standard deviations, the losses.

use super::corrected::CorrectedNetwork;
use super::pass::Pass;
use crate::harmonic_branch::HarmonicBranch;
use crate::optimiser::Descent;
use crate::progress::Log;
use crate::result::{Reconstruction, nmse_pct, result_times_s};
use crate::uncertainty::laplace;
use crate::{Identification, LossTerms, PinnError};

pub(super) fn assemble(
    pass: &Pass<'_>,
    [by_data, branch]: [&HarmonicBranch; 2],
    descent: Descent,
    log: Log<'_>,
) -> Result<Identification, PinnError> {
    let (samples, config) = (pass.inputs.samples, pass.inputs.config);
    let tau_s = result_times_s(samples, config);
    let t_s: Vec<f64> = tau_s.iter().map(|tau| samples.t0_s + tau).collect();
    let losses = losses(pass, &descent);
    let parameters = descent.parameters;
    let corrected = CorrectedNetwork::new(pass, by_data, &parameters);
    let (r_ohm, l_h) = tau_s.iter().map(|tau| corrected.r_l_at(*tau)).unzip();
    let strength = pass.prior.strength;
    let sigmas = laplace(&pass.model, &parameters, pass.noise, strength, &t_s)?;
    let mut chi2 = Vec::new();
    let (mut r_sigma_ohm, mut l_sigma_h) =
        sigmas.map_or_else(Default::default, |s| (s.r_ohm, s.l_h));
    for ((tau, r), l) in tau_s.iter().zip(&mut r_sigma_ohm).zip(&mut l_sigma_h) {
        chi2.push(corrected.raise(*tau, [r, l]));
    }
    // The fundamental is harmonic 0 of the basis: the configuration is checked for that.
    let amplitude = |tau: &f64| branch.phasors(*tau, 0).i.norm() * samples.i_max_ampere;
    let power_ratio = |tau: &f64| branch.power_ratio(*tau) / samples.impedance_scale();
    Ok(Identification {
        impedance_order: pass.inputs.order,
        i_amplitude_a: tau_s.iter().map(amplitude).collect(),
        r_power_ohm: tau_s.iter().map(power_ratio).collect(),
        t_s,
        r_ohm,
        l_h,
        r_sigma_ohm,
        l_sigma_h,
        chi2,
        losses,
        iterations: log.iteration,
        passes: log.pass,
        stopped_because: descent.stopped,
        elapsed_s: log.elapsed_s(),
        nmse_v_pct: nmse_pct(losses.l_i1, &samples.v),
        nmse_i_pct: nmse_pct(losses.l_i2, &samples.i),
        reconstruction: Reconstruction::of_branch(samples, branch),
        history: log.history,
        parameters,
    })
}

/// Terms of eq. (7) at the final parameters.
fn losses(pass: &Pass<'_>, descent: &Descent) -> LossTerms {
    let config = pass.inputs.config;
    let (l_i1, l_i2) = pass.data_losses;
    let l_f = (descent.squares + pass.floor) / config.w_f;
    LossTerms {
        l_f,
        l_i1,
        l_i2,
        total: config.w_f * l_f + config.w_i * (l_i1 + l_i2),
    }
}
