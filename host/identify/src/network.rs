//! The network of `ihd_pinn` on half-cycles of a segment: for `ihd identify`, the studies and the trainer.

use std::path::Path;

use ihd_pinn::{Config, Identified, PinnError, Progress, SlowInputs, Task, TruthAt, Waveform};
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};

use super::model_residual::ModelResidual;
use super::pinn::CarrierInputs;
use super::{Estimate, Watch};

/// The configuration with the segment's own white noise where it names none.
pub fn informed(config: Config, segment: &Segment) -> Config {
    let measured = || WhiteNoise::measure(segment).measured();
    Config {
        noise: config.noise.or_else(measured),
        ..config
    }
}

/// The configuration for a window whose carrier moves, in the mains half-cycle that begins at `crossing_s` in seconds.
pub fn follow(config: &mut Config, carrier: &CarrierInputs, crossing_s: f64) {
    // Of the slow times R and L between are interpolated linearly.
    const SLOW_POINTS: usize = 4;
    let wanted = carrier.intervals.min(MOST_INTERVALS);
    config.spline_intervals = config.spline_intervals.max(wanted);
    config.slow_points = config.slow_points.max(SLOW_POINTS * wanted);
    // It was made for other inputs.
    config.start = None;
    config.inputs = Some(SlowInputs {
        t0_s: carrier.t0_s - crossing_s,
        dt_s: carrier.dt_s,
        functions: carrier.functions.clone(),
    });
}

/// Most spline intervals of a half-cycle that the network takes.
const MOST_INTERVALS: usize = 400;

/// The samples `from` up to `to`, within the mains half-cycle that begins at `crossing_s` in seconds;
/// the waveform's time counts from there.
pub fn waveform(segment: &Segment, (from, to): (usize, usize), crossing_s: f64) -> Waveform<'_> {
    Waveform {
        f_sw_hz: segment.f_sw_hz,
        f_mains_hz: segment.mains_hz,
        t0_s: segment.t_s(from) - crossing_s,
        dt_s: segment.dt_s,
        v_volt: &segment.v_v[from..to],
        i_ampere: &segment.i_a[from..to],
    }
}

/// Trains on the samples of a mains half-cycle and appends what is found to the estimate.
///
/// # Errors
/// [`PinnError`] of [`Task::run`]; the estimate is then as it was.
pub fn half_cycle(
    segment: &Segment,
    range: (usize, usize),
    config: &Config,
    checkpoint: Option<&Path>,
    watch: &mut Watch<'_>,
    estimate: &mut Estimate,
) -> Result<Identified, PinnError> {
    let crossing_s = segment.crossing_of_s(range);
    let truth_at = |t_s: f64| {
        let at = watch.truth.and_then(|truth| truth.at(t_s + crossing_s));
        at.unwrap_or((f64::NAN, f64::NAN))
    };
    let task = Task {
        window: waveform(segment, range, crossing_s),
        config,
        truth: watch.truth.map(|_| &truth_at as TruthAt<'_>),
        checkpoint,
    };
    let found = task.run(&mut |p| (watch.report)(state(p)))?;
    append(&found, crossing_s, estimate);
    estimate.notes.push(format!(
        "half-cycle from {crossing_s:.4} s: {} steps, {}; {}",
        found.iterations,
        found.stopped_because,
        physics(&found)
    ));
    Ok(found)
}

/// Appends what was found in the half-cycle that begins at `crossing_s` in seconds, and a remark where the training came
/// to no end.
pub fn append(found: &Identified, crossing_s: f64, estimate: &mut Estimate) {
    let times_s = found.t_s.iter().map(|t| t + crossing_s);
    estimate.t_s.extend(times_s);
    estimate.r_ohm.extend(&found.r_ohm);
    estimate.l_h.extend(&found.l_h);
    estimate.r_sigma_ohm.extend(&found.r_sigma_ohm);
    estimate.l_sigma_h.extend(&found.l_sigma_h);
    estimate.r_power_ohm.extend(&found.r_power_ohm);
    model_residual(found).note_in(estimate);
    if !found.stopped_because.is_converged() {
        let text = format!(
            "the fit of the half-cycle from {crossing_s:.4} s did not converge ({}, {} steps)",
            found.stopped_because, found.iterations
        );
        let remark = Remark::new("not_converged", Severity::Error, text);
        estimate.remarks.push(remark);
    }
}

fn model_residual(found: &Identified) -> ModelResidual {
    let mut residual = ModelResidual::default();
    for (k, chi2) in found.chi2.iter().enumerate() {
        let relative = [
            found.r_sigma_ohm[k] / found.r_ohm[k],
            found.l_sigma_h[k] / found.l_h[k],
        ];
        residual.add(found.i_amplitude_a[k].powi(2), *chi2, relative);
    }
    residual
}

/// A training's state in words; where the truth is known, the errors of R and L too.
fn state(p: &Progress) -> String {
    let (step, l_f, l_i) = (p.iteration, p.l_f, p.l_i);
    let errors = p
        .mre_pct
        .map_or(String::new(), |(r, l)| format!(", off {r:.2}/{l:.2} %"));
    format!("step {step}, L_f {l_f:.1e}, L_i {l_i:.1e}{errors}")
}

/// P/I_rms² at the crest beside R of the fundamental, and the order of the impedance law.
fn physics(found: &Identified) -> String {
    let largest = |a: &usize, b: &usize| {
        let i = &found.i_amplitude_a;
        i[*a].total_cmp(&i[*b])
    };
    let crest = (0..found.i_amplitude_a.len()).max_by(largest).unwrap_or(0);
    let (r, p) = (found.r_ohm[crest], found.r_power_ohm[crest]);
    let order = match found.impedance_order {
        0.0 => String::new(),
        n => format!(", impedance order {n:.2}"),
    };
    format!("at the crest R {r:.3} Ω, P/I_rms² {p:.3} Ω{order}")
}
