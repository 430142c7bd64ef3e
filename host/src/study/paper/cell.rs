//! One cell: the capture, the estimator, and its errors.

use std::path::Path;

use ihd_pinn::{Config, Identified, Preset, Waveform};

use super::{Cell, Contender, Job, LossAt, PaperStudyError};
use crate::identify::accuracy::{Accuracy, fundamental};
use crate::identify::noise::WhiteNoise;
use crate::identify::{self, Estimate, Method, Segment, Settings};
use crate::study::trial::Trial;

/// Samples of the 50 MS/s that `hybrid` takes one of: the paper's down-sampling.
const DOWNSAMPLING: usize = 10;

/// Entries of a loss curve or of R(t) that are kept.
const KEPT: usize = 250;

/// An estimate over the last half-cycle, and what else its estimator says.
struct Found {
    estimate: Estimate,
    nmse_pct: Option<(f64, f64)>,
    identified: Option<Identified>,
}

/// Runs one cell on its capture.
pub(super) fn run(
    job: &Job,
    trial: &Trial,
    checkpoint: &Path,
    progress: &mut dyn FnMut(String),
) -> Result<Cell, PaperStudyError> {
    let stem = job.file_stem();
    let nothing = || PaperStudyError::Nothing(stem.clone());
    let noisy = trial.noisy(job.snr_db, job.seed);
    let last = *noisy.half_cycles().last().ok_or_else(nothing)?;
    let found = match job.contender {
        Contender::Other(method) => other(job, method, trial, &noisy, last)?,
        Contender::Pinn(preset) => {
            let mut config = configured(job, preset);
            config.noise = WhiteNoise::measure(&noisy).told();
            network(job, &config, trial, &noisy, last, checkpoint, progress)?
        }
    };
    let from_s = noisy.t_s(last.0);
    let accuracy = Accuracy::of(&found.estimate, &noisy, &trial.truth, from_s);
    let accuracy = accuracy.ok_or_else(nothing)?;
    let truth = fundamental(&trial.truth);
    let identified = found.identified.as_ref();
    let inside = |t: f64| t >= from_s;
    let truth_points = truth.t_s.iter().zip(truth.r_ohm.iter().zip(&truth.l_h));
    let truth_points = truth_points.map(|(t, (r, l))| (*t, *r, *l));
    Ok(Cell {
        job: *job,
        whole: accuracy.whole.into(),
        middle: accuracy.middle.into(),
        nmse_pct: found.nmse_pct,
        power_r_pct: identified.and_then(|i| power_error_pct(i, trial, from_s)),
        elapsed_s: found.estimate.elapsed.as_secs_f64(),
        steps: identified.map_or(0, |i| i.iterations),
        stopped: identified.map_or(String::new(), |i| i.stopped_because.to_string()),
        track: thinned(found.estimate.points().filter(|p| inside(p.0)).collect()),
        truth: thinned(truth_points.filter(|p| inside(p.0)).collect()),
        losses: identified.map_or(Vec::new(), loss_curve),
    })
}

fn configured(job: &Job, preset: Preset) -> Config {
    let mut config = preset.config();
    config.seed = job.seed;
    config.deterministic = true;
    if let (Some(epochs), Some(_)) = (job.epochs, &config.vi_mlp) {
        config.max_iterations = epochs;
    }
    config
}

fn other(
    job: &Job,
    method: Method,
    trial: &Trial,
    noisy: &Segment,
    last: (usize, usize),
) -> Result<Found, PaperStudyError> {
    let estimate = identify::run(method, noisy, &Settings::default());
    let estimate = estimate.map_err(|source| PaperStudyError::Identify {
        cell: job.file_stem(),
        source,
    })?;
    let nmse = |hat: &[f32], clean: &[f64]| {
        let hat = hat.get(last.0..last.1)?;
        let hat: Vec<f64> = hat.iter().map(|x| f64::from(*x)).collect();
        Some(nmse_pct(&hat, &clean[last.0..last.1]))
    };
    let v = nmse(&estimate.v_hat_v, &trial.clean.v_v);
    let i = nmse(&estimate.i_hat_a, &trial.clean.i_a);
    Ok(Found {
        estimate,
        nmse_pct: v.zip(i),
        identified: None,
    })
}

fn network(
    job: &Job,
    config: &Config,
    trial: &Trial,
    noisy: &Segment,
    (from, to): (usize, usize),
    checkpoint: &Path,
    progress: &mut dyn FnMut(String),
) -> Result<Found, PaperStudyError> {
    // A VI-MLP thins out itself.
    let step = if config.vi_mlp.is_some() {
        1
    } else {
        DOWNSAMPLING
    };
    let thin = |x: &[f64]| -> Vec<f64> { x[from..to].iter().step_by(step).copied().collect() };
    let (v_volt, i_ampere) = (thin(&noisy.v_v), thin(&noisy.i_a));
    let crossing_s = noisy.crossing_of_s((from, to));
    let truth = fundamental(&trial.truth);
    let truth_at = |t_s: f64| truth.at(t_s + crossing_s).unwrap_or((f64::NAN, f64::NAN));
    let task = ihd_pinn::Task {
        window: Waveform {
            f_sw_hz: noisy.f_sw_hz,
            f_mains_hz: noisy.mains_hz,
            t0_s: noisy.t_s(from) - crossing_s,
            dt_s: noisy.dt_s * step as f64,
            v_volt: &v_volt,
            i_ampere: &i_ampere,
        },
        config,
        truth: Some(&truth_at),
        checkpoint: Some(checkpoint),
    };
    let found = task.run(&mut |p| {
        let (r, l) = p.mre_pct.unwrap_or((f64::NAN, f64::NAN));
        let (step, l_f, l_i) = (p.iteration, p.l_f, p.l_i);
        progress(format!(
            "step {step}, L_f {l_f:.1e}, L_i {l_i:.1e}, R {r:.2} %, L {l:.2} %"
        ));
    });
    let found = found.map_err(|source| PaperStudyError::Pinn {
        cell: job.file_stem(),
        source,
    })?;
    let mut estimate = Estimate::new(Method::Pinn, noisy.f_sw_hz);
    estimate.t_s = found.t_s.iter().map(|t| t + crossing_s).collect();
    estimate.r_ohm.clone_from(&found.r_ohm);
    estimate.l_h.clone_from(&found.l_h);
    estimate.elapsed = std::time::Duration::from_secs_f64(found.elapsed_s);
    let said = &found.reconstruction;
    let clean =
        |x: &[f64]| -> Vec<f64> { said.sample.iter().map(|n| x[from + n * step]).collect() };
    Ok(Found {
        nmse_pct: Some((
            nmse_pct(&said.v_volt, &clean(&trial.clean.v_v)),
            nmse_pct(&said.i_ampere, &clean(&trial.clean.i_a)),
        )),
        estimate,
        identified: Some(found),
    })
}

/// Σ(x̂ − x)²/Σx² in percent.
fn nmse_pct(hat: &[f64], right: &[f64]) -> f64 {
    let error: f64 = hat.iter().zip(right).map(|(a, b)| (a - b).powi(2)).sum();
    100.0 * error / right.iter().map(|x| x * x).sum::<f64>()
}

/// Mean of P/I_rms² against the truth's, weighted with I², in percent.
fn power_error_pct(found: &Identified, trial: &Trial, from_s: f64) -> Option<f64> {
    let (mut sum, mut weights) = (0.0, 0.0);
    for period in trial.truth.iter().filter(|p| p.t_s >= from_s) {
        let since_s = period.t_s - from_s;
        let after = found.t_s.partition_point(|t| *t < since_s);
        let r_ohm = *found.r_power_ohm.get(after)?;
        let weight = period.i_a * period.i_a;
        sum += weight * (r_ohm / period.r_power_ohm - 1.0).abs();
        weights += weight;
    }
    (weights > 0.0).then_some(100.0 * sum / weights)
}

fn loss_curve(found: &Identified) -> Vec<LossAt> {
    let all = found.history.iter().map(|p| LossAt {
        step: p.iteration,
        l_f: p.l_f,
        l_i: p.l_i,
    });
    thinned(all.collect())
}

/// At most [`KEPT`] entries, evenly chosen, the last among them.
fn thinned<T: Copy>(all: Vec<T>) -> Vec<T> {
    let step = all.len().div_ceil(KEPT).max(1);
    let mut kept: Vec<T> = all.iter().rev().step_by(step).copied().collect();
    kept.reverse();
    kept
}
