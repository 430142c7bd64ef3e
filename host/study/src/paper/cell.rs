//! Cell of the study: the capture, the estimator, and its errors.

use std::path::Path;

use ihd_identify::accuracy::{Accuracy, fundamental};
use ihd_identify::network::{identify_half_cycle, with_measured_noise};
use ihd_identify::trajectory::TrajectoryCursor;
use ihd_identify::{Estimate, IdentifyOptions, Method, ProgressSink};
use ihd_pinn::{Identification, PinnConfig};
use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;

use super::nmse::{Nmse, unfiltered_itself};
use super::{Contender, LossAt, PaperCell, PaperJob, PaperStudyError, Point, StudyPlace, origin};

/// Limit of stored entries of a loss curve or of R(t).
const MAX_ENTRIES: usize = 250;

/// Estimate over the last half-cycle, and additional results of its estimator.
struct CellEstimate {
    estimate: Estimate,
    nmse: Option<Nmse>,
    identified: Option<Identification>,
}

/// Runs one cell on its capture.
pub(super) fn run(
    job: &PaperJob,
    place: &StudyPlace<'_>,
    point: &Point,
    checkpoint: &Path,
    progress: &mut dyn FnMut(String),
) -> Result<PaperCell, PaperStudyError> {
    let trial = &point.trial;
    let stem = job.file_stem();
    let nothing = || PaperStudyError::Nothing(stem.clone());
    let noisy = trial.noisy(job.snr_db, job.seed);
    let last = *noisy.half_cycles().last().ok_or_else(nothing)?;
    let (settings, result) = match &job.contender {
        Contender::Other(method) => (None, other(job, *method, point, &noisy, last)?),
        Contender::Pinn(preset) => {
            let config = origin::configured(job, preset, place.presets)?;
            let own = with_measured_noise(config.clone(), &noisy);
            let result = network(job, &own, point, &noisy, last, checkpoint, progress)?;
            (Some(config), result)
        }
    };
    let from_s = noisy.t_s(last.0);
    let against =
        |truth: &[PeriodTruth]| Accuracy::measure(&result.estimate, &noisy, truth, from_s);
    let accuracy = against(&trial.truth).ok_or_else(nothing)?;
    let describing = point.describing.as_ref().and_then(|truth| against(truth));
    let truth = fundamental(&trial.truth);
    let identified = result.identified.as_ref();
    let inside = |t: f64| t >= from_s;
    let truth_points = truth.t_s.iter().zip(truth.r_ohm.iter().zip(&truth.l_h));
    let truth_points = truth_points.map(|(t, (r, l))| (*t, *r, *l));
    Ok(PaperCell {
        job: job.clone(),
        build: place.build.clone(),
        settings,
        whole: accuracy.whole.into(),
        middle: accuracy.middle.into(),
        describing: describing.map(|a| a.whole.into()),
        impedance_order: identified.map(|i| i.impedance_order),
        nmse_pct: result.nmse.map(|n| n.clean),
        nmse_filtered_pct: result.nmse.map(|n| n.filtered),
        nmse_both_filtered_pct: result.nmse.map(|n| n.both),
        nmse_unfiltered_itself_pct: Some(unfiltered_itself(point, last)),
        power_r_pct: power_error_pct(&result.estimate, &trial.truth, from_s, |p| p.r_power_ohm),
        power_describing_pct: point
            .describing
            .as_ref()
            .and_then(|truth| power_error_pct(&result.estimate, truth, from_s, |p| p.r_ohm[0])),
        elapsed_s: result.estimate.elapsed.as_secs_f64(),
        steps: identified.map_or(0, |i| i.iterations),
        stopped: identified.map_or(String::new(), |i| i.stopped_because.to_string()),
        trajectory: thinned(result.estimate.points().filter(|p| inside(p.0)).collect()),
        truth: thinned(truth_points.filter(|p| inside(p.0)).collect()),
        noise_in_samples: job
            .snr_db
            .map(|_| noise_in_samples(&noisy, &trial.clean, last)),
        losses: identified.map_or(Vec::new(), loss_curve),
    })
}

fn other(
    job: &PaperJob,
    method: Method,
    point: &Point,
    noisy: &Segment,
    last: (usize, usize),
) -> Result<CellEstimate, PaperStudyError> {
    let estimate = ihd_identify::run(method, noisy, &IdentifyOptions::default());
    let estimate = estimate.map_err(|source| PaperStudyError::Identify {
        cell: job.file_stem(),
        source,
    })?;
    let hat = |x: &[f32]| -> Option<Vec<f64>> {
        let x = x.get(last.0..last.1)?;
        Some(x.iter().map(|x| f64::from(*x)).collect())
    };
    let waveforms = hat(&estimate.v_hat_v).zip(hat(&estimate.i_hat_a));
    let samples: Vec<usize> = (last.0..last.1).collect();
    Ok(CellEstimate {
        nmse: waveforms.and_then(|(v, i)| Nmse::compute(&v, &i, &samples, point)),
        estimate,
        identified: None,
    })
}

fn network(
    job: &PaperJob,
    config: &PinnConfig,
    point: &Point,
    noisy: &Segment,
    (from, to): (usize, usize),
    checkpoint: &Path,
    progress: &mut dyn FnMut(String),
) -> Result<CellEstimate, PaperStudyError> {
    let truth = fundamental(&point.trial.truth);
    let mut sink = ProgressSink {
        truth: Some(&truth),
        report: progress,
    };
    let mut estimate = Estimate::new(Method::Pinn, noisy.f_sw_hz);
    let identification = identify_half_cycle(
        noisy,
        (from, to),
        config,
        Some(checkpoint),
        &mut sink,
        &mut estimate,
    );
    let identification = identification.map_err(|source| PaperStudyError::Pinn {
        cell: job.file_stem(),
        source,
    })?;
    estimate.elapsed = std::time::Duration::from_secs_f64(identification.elapsed_s);
    let reconstruction = identification.reconstruction.waveforms();
    let samples: Vec<usize> = reconstruction.sample.iter().map(|n| from + n).collect();
    let (v, i) = (&reconstruction.v_volt, &reconstruction.i_ampere);
    Ok(CellEstimate {
        nmse: Nmse::compute(v, i, &samples, point),
        estimate,
        identified: Some(identification),
    })
}

/// Mean deviation of P/I_rms² from a resistance of the truth, weighted with I², in percent; `None` if the estimate has none.
fn power_error_pct(
    estimate: &Estimate,
    truth: &[PeriodTruth],
    from_s: f64,
    right: impl Fn(&PeriodTruth) -> f64,
) -> Option<f64> {
    let mut trajectory = TrajectoryCursor::from(estimate, from_s)?;
    let (mut sum, mut weights) = (0.0, 0.0);
    for period in truth.iter().filter(|p| p.t_s >= from_s) {
        let weight = period.i_a * period.i_a;
        sum += weight * (trajectory.r_power_ohm(period.t_s)? / right(period) - 1.0).abs();
        weights += weight;
    }
    (weights > 0.0).then_some(100.0 * sum / weights)
}

/// Mean squared noise of voltage and current over the half-cycle, each over its largest sample squared: eqs. (5) and (6) for a VI
/// branch that yields the waveforms without noise.
fn noise_in_samples(noisy: &Segment, clean: &Segment, (from, to): (usize, usize)) -> f64 {
    let share = |x: &[f64], clean: &[f64]| {
        let largest = x.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let squares = x.iter().zip(clean).map(|(a, b)| (a - b).powi(2));
        squares.sum::<f64>() / (x.len() as f64 * largest * largest)
    };
    share(&noisy.v_v[from..to], &clean.v_v[from..to])
        + share(&noisy.i_a[from..to], &clean.i_a[from..to])
}

fn loss_curve(identified: &Identification) -> Vec<LossAt> {
    let all = identified.history.iter().map(|p| LossAt {
        step: p.iteration,
        l_f: p.l_f,
        l_i: p.l_i,
    });
    thinned(all.collect())
}

/// Returns at most [`MAX_ENTRIES`] entries, evenly chosen, including the last.
fn thinned<T: Copy>(all: Vec<T>) -> Vec<T> {
    let step = all.len().div_ceil(MAX_ENTRIES).max(1);
    let mut few: Vec<T> = all.iter().rev().step_by(step).copied().collect();
    few.reverse();
    few
}
