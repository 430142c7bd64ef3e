//! The whole identification: VI branch, RL-MLP, and the alternation between them.

use std::f64::consts::TAU;
use std::path::Path;

use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::{self, AtHarmonic, ImpedanceOrder, Named};
use crate::levenberg_marquardt::{Descent, Prior};
use crate::loss::{SlowPhysics, noise_variance, slow_times_s, white_noise};
use crate::parameters::Parameters;
use crate::progress::{Log, relative_change};
use crate::result::{nmse_pct, reconstruction, result_times_s};
use crate::slow_model::SlowModel;
use crate::uncertainty::{self, laplace};
use crate::vi_system::{DataSystem, Impedance, PhysicsTerm};
use crate::waveform::Normalised;
use crate::{
    Config, Identified, Losses, Optimiser, PinnError, Progress, Waveform, adam,
    levenberg_marquardt, networks,
};
use ihd_spline::CubicSpline;

/// R and L rest when they move by less than this part of the standard deviation that noise leaves even a
/// constant load: what is below it is noise.
const REST: f64 = 0.1;

/// Truth of R (ohm) and L (H) at a time in seconds after the mains zero crossing.
pub type TruthAt<'a> = &'a dyn Fn(f64) -> (f64, f64);

/// One window to identify, and what may be known or kept beside it.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The samples.
    pub window: Waveform<'a>,
    /// The settings.
    pub config: &'a Config,
    /// Where the truth is known, progress carries the errors against it.
    pub truth: Option<TruthAt<'a>>,
    /// A training with a VI-MLP goes on from this burnpack file if it exists, and writes it every
    /// 100 epochs and at the end.
    pub checkpoint: Option<&'a Path>,
}

/// Identifies R(t) and L(t) of the coil from one window by minimising the paper's eq. (7).
///
/// `progress` is called after every accepted optimiser step; see [`Task::run`].
///
/// # Errors
/// [`PinnError`] if the window or the configuration cannot be used; a limit that is reached or a
/// loss that stops being finite is no error but a [`crate::StoppedBecause`].
pub fn identify(
    window: &Waveform<'_>,
    config: &Config,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Identified, PinnError> {
    let task = Task {
        window: *window,
        config,
        truth: None,
        checkpoint: None,
    };
    task.run(progress)
}

impl Task<'_> {
    /// With the harmonic VI branch, block-coordinate descent: the VI branch by linear least squares,
    /// the RL-MLP by the configured optimiser, alternating. With a VI-MLP both networks by Adam.
    ///
    /// # Errors
    /// As [`identify`], and [`PinnError::Checkpoint`] for a checkpoint that does not belong here.
    pub fn run(&self, progress: &mut dyn FnMut(&Progress)) -> Result<Identified, PinnError> {
        self.config.validate()?;
        let mut samples = self.window.normalise()?;
        if self.config.vi_mlp.is_none() {
            let highest = self.config.harmonics.iter().copied().max().unwrap_or(1);
            samples = samples.averaged(self.config.most_points, highest);
        }
        let mut members = Vec::with_capacity(self.config.ensemble);
        for member in 0..self.config.ensemble {
            let config = Config {
                seed: self.config.seed.wrapping_add(member as u64),
                ensemble: 1,
                ..self.config.clone()
            };
            let checkpoint = self.checkpoint.map(|path| match member {
                0 => path.to_owned(),
                _ => path.with_extension(format!("{member}.bpk")),
            });
            let mut log = Log::start(&config, progress);
            log.truth = self
                .truth
                .map(|truth| truth_outputs(truth, &samples, &config));
            members.push(match &config.vi_mlp {
                None => hybrid(&samples, &config, log)?,
                Some(vi) => networks::identify(&samples, &config, vi, checkpoint.as_deref(), log)?,
            });
        }
        Ok(best_of(members))
    }
}

/// The member of least loss, with the members' spread for its uncertainty.
fn best_of(mut members: Vec<Identified>) -> Identified {
    let spread = |of: fn(&Identified) -> &[f64]| {
        let values: Vec<&[f64]> = members.iter().map(of).collect();
        uncertainty::spread(&values)
    };
    let sigmas = (members.len() > 1).then(|| (spread(|m| &m.r_ohm), spread(|m| &m.l_h)));
    let total_s = members.iter().map(|m| m.elapsed_s).sum();
    let order = |a: &Identified, b: &Identified| a.losses.total.total_cmp(&b.losses.total);
    members.sort_by(order);
    let mut best = members.swap_remove(0);
    best.elapsed_s = total_s;
    if let Some((r, l)) = sigmas {
        (best.r_sigma_ohm, best.l_sigma_h) = (r, l);
    }
    best
}

/// R / r_scale and L / l_scale of the truth at the slow times, alternating.
fn truth_outputs(truth: TruthAt<'_>, samples: &Normalised, config: &Config) -> Vec<f64> {
    slow_times_s(samples.duration_s(), config.slow_points)
        .iter()
        .flat_map(|tau| {
            let (r, l) = truth(samples.t0_s + tau);
            [r / config.r_scale_ohm, l / config.l_scale_h]
        })
        .collect()
}

fn hybrid(
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
        let rest = config
            .tolerance
            .max(REST * physics.relative_sigma(constant, noise));
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
            let spread = (noise, prior.strength);
            let found = assemble(
                samples, config, &branch, &model, spread, descent, losses, log,
            )?;
            return Ok(Identified {
                impedance_order: order,
                ..found
            });
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

/// `spread` holds the variance of a residual and the prior's strength.
#[allow(clippy::too_many_arguments)] // the parts of one result
fn assemble(
    samples: &Normalised,
    config: &Config,
    branch: &HarmonicBranch,
    model: &SlowModel,
    (noise, strength): (f64, f64),
    descent: Descent,
    losses: Losses,
    log: Log<'_>,
) -> Result<Identified, PinnError> {
    let tau_s = result_times_s(samples, config);
    let t_s: Vec<f64> = tau_s.iter().map(|tau| samples.t0_s + tau).collect();
    let parameters = descent.parameters;
    let (r_ohm, l_h) = t_s.iter().map(|t| parameters.r_l_at(*t)).unzip();
    let sigmas = laplace(model, &parameters, noise, strength, &t_s)?;
    let (r_sigma_ohm, l_sigma_h) = sigmas.map_or_else(Default::default, |s| (s.r_ohm, s.l_h));
    Ok(Identified {
        // The fundamental is harmonic 0 of the basis: the configuration is checked for that.
        impedance_order: 0.0,
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
