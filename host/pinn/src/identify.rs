//! The whole identification: VI branch, RL-MLP, and the alternation between them.

use std::f64::consts::TAU;

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::levenberg_marquardt::{Descent, Prior};
use crate::loss::{SlowPhysics, noise_variance, slow_times_s};
use crate::parameters::Parameters;
use crate::progress::{Log, relative_change};
use crate::vi_system::{DataSystem, Impedance, PhysicsTerm};
use crate::waveform::Normalised;
use crate::{
    Config, Identified, Losses, Optimiser, PinnError, Progress, Waveform, adam, levenberg_marquardt,
};
use ihd_spline::CubicSpline;

/// Identifies R(t) and L(t) of the coil from one window by minimising the paper's eq. (7).
///
/// Block-coordinate descent: the VI branch by linear least squares, the RL-MLP by the configured
/// optimiser, alternating. `progress` is called after every accepted optimiser step.
///
/// # Errors
/// [`PinnError`] if the window or the configuration cannot be used; a limit that is reached or a
/// loss that stops being finite is no error but a [`crate::StoppedBecause`].
pub fn identify(
    window: &Waveform<'_>,
    config: &Config,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Identified, PinnError> {
    config.validate()?;
    let mut log = Log::start(config, progress);
    let samples = window.normalise()?;
    let basis = harmonic_basis(&samples, config)?;
    let harmonics: Vec<usize> = (0..basis.harmonics.len())
        .filter(|&index| config.physics_harmonics.contains(&basis.harmonics[index]))
        .collect();
    let system = DataSystem::assemble(&samples, basis);
    let mut branch = system.fit()?;
    let mut parameters = network_outline(&samples, config);
    let mut warm = config.start.is_some();
    loop {
        log.pass += 1;
        let physics = SlowPhysics::condense(
            &branch,
            &samples,
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
        let (l_i1, l_i2) = branch.data_losses(&samples);
        let noise = noise_variance(&samples, &branch, (l_i1, l_i2), config.w_f, {
            let [r, l] = constant;
            [r * parameters.r_scale_ohm, l * parameters.l_scale_h]
        });
        log.data_loss = config.w_i * (l_i1 + l_i2);
        log.floor = physics.floor;
        let before = outputs(&parameters, &samples, &physics.tau_s);
        let prior = Prior {
            strength: match config.weight_width {
                0.0 => 0.0,
                width => noise / (width * width),
            },
            centre: parameters.constant(constant).flat(),
        };
        let descent = train(&physics, &samples, parameters, &prior, config, &mut log)?;
        let after = outputs(&descent.parameters, &samples, &physics.tau_s);
        let rests = log.pass > 1 && relative_change(&before, &after) < config.tolerance;
        if rests || log.pass >= config.outer_passes || !descent.stopped.is_converged() {
            let l_f = (descent.squares + physics.floor) / config.w_f;
            let losses = Losses {
                l_f,
                l_i1,
                l_i2,
                total: config.w_f * l_f + log.data_loss,
            };
            return Ok(assemble(&samples, config, &branch, descent, losses, log));
        }
        parameters = descent.parameters;
        branch = system.fit_with_physics(&PhysicsTerm {
            weight: config.w_f / config.w_i,
            impedance: &impedances(&parameters, &samples, &physics.tau_s),
            harmonics: &harmonics,
        })?;
    }
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
        },
    }
}

fn train(
    physics: &SlowPhysics,
    samples: &Normalised,
    parameters: Parameters,
    prior: &Prior,
    config: &Config,
    log: &mut Log<'_>,
) -> Result<Descent, PinnError> {
    let device = config.backend.device();
    let device = match config.optimiser {
        Optimiser::LevenbergMarquardt => device,
        Optimiser::Adam => device.autodiff(),
    };
    let physics = physics.on_device(samples, &parameters, config.backend, &device);
    match config.optimiser {
        Optimiser::LevenbergMarquardt => {
            levenberg_marquardt::descend(&physics, parameters, prior, config.tolerance, log)
        }
        Optimiser::Adam => adam::descend(
            &physics,
            parameters,
            config.learning_rate,
            config.tolerance,
            log,
        ),
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

fn assemble(
    samples: &Normalised,
    config: &Config,
    branch: &HarmonicBranch,
    descent: Descent,
    losses: Losses,
    log: Log<'_>,
) -> Identified {
    let last = (config.slow_points - 1) as f64;
    let tau_s: Vec<f64> = (0..config.slow_points)
        .map(|k| k as f64 / last * samples.duration_s())
        .collect();
    let (r_ohm, l_h) = tau_s
        .iter()
        .map(|tau| descent.parameters.r_l_at(samples.t0_s + tau))
        .unzip();
    let nmse_pct =
        |l_i: f64, x: &[f64]| 100.0 * l_i * x.len() as f64 / x.iter().map(|x| x * x).sum::<f64>();
    Identified {
        // The fundamental is harmonic 0 of the basis: the configuration is checked for that.
        i_amplitude_a: tau_s
            .iter()
            .map(|&tau| branch.phasors(tau, 0).i.norm() * samples.i_max_ampere)
            .collect(),
        t_s: tau_s.iter().map(|tau| samples.t0_s + tau).collect(),
        r_ohm,
        l_h,
        losses,
        iterations: log.iteration,
        passes: log.pass,
        stopped_because: descent.stopped,
        elapsed_s: log.elapsed_s(),
        nmse_v_pct: nmse_pct(losses.l_i1, &samples.v),
        nmse_i_pct: nmse_pct(losses.l_i2, &samples.i),
        history: log.history,
        parameters: descent.parameters,
    }
}
