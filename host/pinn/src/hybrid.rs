//! Block-coordinate descent with the harmonic VI branch: the branch by linear least squares, the RL-MLP by
//! the configured optimiser, alternating.

use std::f64::consts::TAU;

use ihd_spline::CubicSpline;

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::{self, AtHarmonic, ImpedanceOrder, Named};
use crate::levenberg_marquardt::{Descent, Prior};
use crate::loss::{SlowPhysics, slow_times_s};
use crate::noise::{noise_variance, white_noise};
use crate::parameters::Parameters;
use crate::progress::{Log, relative_change};
use crate::result::{nmse_pct, reconstruction, result_times_s};
use crate::slow_model::SlowModel;
use crate::uncertainty::laplace;
use crate::vi_system::{DataSystem, Impedance, PhysicsTerm};
use crate::waveform::Normalised;
use crate::{Config, Identified, Losses, Optimiser, PinnError, adam, levenberg_marquardt};

/// R and L rest when they move by less than this part of the standard deviation that noise leaves
/// even a constant load: what is below it is noise.
const REST: f64 = 0.1;

/// Trains on one window.
pub(crate) fn hybrid(
    samples: &Normalised,
    config: &Config,
    mut log: Log<'_>,
) -> Result<Identified, PinnError> {
    let basis = harmonic_basis(samples, config)?;
    let system = DataSystem::assemble(samples, basis);
    let mut branch = system.fit()?;
    let mut parameters = network_outline(samples, config);
    let order = impedance_order(&branch, samples, &parameters, config);
    let harmonics = laws(order, &branch.basis, config);
    let mut warm = config.start.is_some();
    loop {
        log.pass += 1;
        let physics = SlowPhysics::condense(
            &branch,
            samples,
            &parameters,
            &harmonics,
            config.w_f,
            slow_times_s(samples.duration_s(), config.slow_points),
        );
        let constant = physics.best_constant();
        if !warm {
            parameters = parameters.initial(&config.hidden_layers, config.seed, constant);
            warm = true;
        }
        let (l_i1, l_i2) = branch.data_losses(samples);
        let white = white_noise(samples, &branch, (l_i1, l_i2), config.noise);
        let noise = noise_variance(samples, white, config.w_f, {
            let [r, l] = constant;
            [r * parameters.r_scale_ohm, l * parameters.l_scale_h]
        });
        log.data_loss = config.w_i * (l_i1 + l_i2);
        log.floor = physics.floor;
        let before = outputs(&parameters, samples, &physics.tau_s);
        let prior = Prior {
            strength: match config.weight_width {
                0.0 => 0.0,
                width => noise / (width * width),
            },
            centre: parameters.constant(constant).flat(),
        };
        let model = slow_model(&physics, samples, &parameters, config);
        let rest = match config.tolerance {
            0.0 => 0.0,
            told => told.max(REST * physics.relative_sigma(constant, noise)),
        };
        let descent = train(&model, parameters, &prior, config, rest, &mut log)?;
        let after = outputs(&descent.parameters, samples, &physics.tau_s);
        let rests = log.pass > 1 && relative_change(&before, &after) < rest;
        if rests || log.pass >= config.outer_passes || !descent.stopped.is_converged() {
            let l_f = (descent.squares + physics.floor) / config.w_f;
            let losses = Losses {
                l_f,
                l_i1,
                l_i2,
                total: config.w_f * l_f + log.data_loss,
            };
            let known = Known {
                noise,
                strength: prior.strength,
                order,
            };
            return assemble(
                samples, config, &branch, &model, known, descent, losses, log,
            );
        }
        parameters = descent.parameters;
        branch = system.fit_with_physics(&PhysicsTerm {
            weight: config.w_f / config.w_i,
            impedance: &impedances(&parameters, samples, &physics.tau_s),
            harmonics: &harmonics,
        })?;
    }
}

/// The law of this order at the physics harmonics.
fn laws(order: f64, basis: &HarmonicBasis, config: &Config) -> Vec<AtHarmonic> {
    let covered = |h: &u32| config.physics_harmonics.contains(h);
    let all = basis.harmonics.iter().enumerate();
    all.filter(|(_, h)| covered(h))
        .map(|(index, _)| AtHarmonic::new(order, basis, index))
        .collect()
}

/// The order as given, or the one with which R and L of each slow time leave least of the physics
/// term, before any network.
fn impedance_order(
    branch: &HarmonicBranch,
    samples: &Normalised,
    parameters: &Parameters,
    config: &Config,
) -> f64 {
    match config.impedance_order {
        ImpedanceOrder::Given(order) => return order,
        ImpedanceOrder::Named(Named::Identified) => {}
    }
    let misfit = |order: f64| {
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let laws = laws(order, &branch.basis, config);
        SlowPhysics::condense(branch, samples, parameters, &laws, config.w_f, times).floor
    };
    impedance_law::least(misfit)
}

/// The VI branch's functions, if the sampling can tell them apart.
fn harmonic_basis(samples: &Normalised, config: &Config) -> Result<HarmonicBasis, PinnError> {
    let half_cycle_s = 0.5 / samples.f_mains_hz;
    let share = samples.duration_s() / half_cycle_s;
    let intervals = ((config.spline_intervals as f64 * share).ceil() as usize).max(4);
    let basis = HarmonicBasis {
        spline: CubicSpline::new(intervals, samples.duration_s()),
        harmonics: config.harmonics.clone(),
        omega: samples.omega,
        gains: config.harmonics.iter().map(|h| samples.gain(*h)).collect(),
    };
    let (f_sw_hz, f_adc_hz) = (samples.omega / TAU, 1.0 / samples.dt_s);
    let harmonic = config.harmonics.iter().copied().max().unwrap_or(1);
    let needed_hz = 2.0 * f64::from(harmonic) * f_sw_hz;
    if f_adc_hz <= needed_hz {
        return Err(PinnError::SamplingTooSlow {
            f_adc_hz,
            f_sw_hz,
            harmonic,
            needed_hz,
        });
    }
    let per_period = f_adc_hz / f_sw_hz;
    for (needed, why) in [
        (4 * basis.len(), "four per unknown"),
        (
            (3.0 * per_period * intervals as f64).ceil() as usize,
            "three switching periods per spline interval",
        ),
    ] {
        if samples.len() < needed {
            let pairs = samples.len();
            return Err(PinnError::TooShort { pairs, needed, why });
        }
    }
    Ok(basis)
}

/// The parameters to start from, or the network's scales with no layers yet.
fn network_outline(samples: &Normalised, config: &Config) -> Parameters {
    match &config.start {
        // The window at hand has the last word on the mains frequency.
        Some(start) => Parameters {
            f_mains_hz: samples.f_mains_hz,
            ..start.clone()
        },
        None => Parameters {
            embedding: config.embedding,
            f_mains_hz: samples.f_mains_hz,
            r_scale_ohm: config.r_scale_ohm,
            l_scale_h: config.l_scale_h,
            layers: Vec::new(),
            vi_layers: Vec::new(),
        },
    }
}

fn slow_model(
    physics: &SlowPhysics,
    samples: &Normalised,
    parameters: &Parameters,
    config: &Config,
) -> SlowModel {
    match config.backend.device() {
        None => SlowModel::own(physics, samples, parameters),
        Some(device) => {
            let device = match config.optimiser {
                Optimiser::LevenbergMarquardt => device,
                Optimiser::Adam => device.autodiff(),
            };
            let tensors = physics.on_device(samples, parameters, config.backend, &device);
            SlowModel::Burn(Box::new(tensors))
        }
    }
}

/// Trains until R and L rest: they move by less than `rest`, relative to them.
fn train(
    model: &SlowModel,
    parameters: Parameters,
    prior: &Prior,
    config: &Config,
    rest: f64,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    match config.optimiser {
        Optimiser::LevenbergMarquardt => {
            levenberg_marquardt::descend(model, parameters, prior, rest, log)
        }
        Optimiser::Adam => adam::descend(model, parameters, config.learning_rate, rest, log),
    }
}

/// R, L alternating, at the slow times.
fn outputs(parameters: &Parameters, samples: &Normalised, tau_s: &[f64]) -> Vec<f64> {
    tau_s
        .iter()
        .flat_map(|tau| {
            let (r, l) = parameters.r_l_at(samples.t0_s + tau);
            [r, l]
        })
        .collect()
}

fn impedances(parameters: &Parameters, samples: &Normalised, tau_s: &[f64]) -> Vec<Impedance> {
    let scale = samples.impedance_scale();
    tau_s
        .iter()
        .map(|&tau_s| {
            let (r, l) = parameters.r_l_at(samples.t0_s + tau_s);
            Impedance {
                tau_s,
                r: r * scale,
                l: l * scale,
            }
        })
        .collect()
}

/// What a fit was made with.
struct Known {
    /// Variance of a residual.
    noise: f64,
    /// The prior's.
    strength: f64,
    /// Order of the impedance law.
    order: f64,
}

#[allow(clippy::too_many_arguments)] // the parts of one result
fn assemble(
    samples: &Normalised,
    config: &Config,
    branch: &HarmonicBranch,
    model: &SlowModel,
    known: Known,
    descent: Descent,
    losses: Losses,
    log: Log<'_>,
) -> Result<Identified, PinnError> {
    let tau_s = result_times_s(samples, config);
    let t_s: Vec<f64> = tau_s.iter().map(|tau| samples.t0_s + tau).collect();
    let parameters = descent.parameters;
    let (r_ohm, l_h) = t_s.iter().map(|t| parameters.r_l_at(*t)).unzip();
    let sigmas = laplace(model, &parameters, known.noise, known.strength, &t_s)?;
    let (r_sigma_ohm, l_sigma_h) = sigmas.map_or_else(Default::default, |s| (s.r_ohm, s.l_h));
    Ok(Identified {
        // The fundamental is harmonic 0 of the basis: the configuration is checked for that.
        impedance_order: known.order,
        i_amplitude_a: tau_s
            .iter()
            .map(|&tau| branch.phasors(tau, 0).i.norm() * samples.i_max_ampere)
            .collect(),
        r_power_ohm: tau_s
            .iter()
            .map(|&tau| branch.power_ratio(tau) / samples.impedance_scale())
            .collect(),
        t_s,
        r_ohm,
        l_h,
        r_sigma_ohm,
        l_sigma_h,
        losses,
        iterations: log.iteration,
        passes: log.pass,
        stopped_because: descent.stopped,
        elapsed_s: log.elapsed_s(),
        nmse_v_pct: nmse_pct(losses.l_i1, &samples.v),
        nmse_i_pct: nmse_pct(losses.l_i2, &samples.i),
        reconstruction: reconstruction(samples, branch.signals(samples)),
        history: log.history,
        parameters,
    })
}
