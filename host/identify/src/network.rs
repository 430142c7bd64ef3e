//! The network of `ihd_pinn` on half-cycles of a segment, for `ihd identify`, the studies and the trainer.

use std::path::Path;

use ihd_pinn::{
    Identification, IdentifyTask, PinnConfig, PinnError, SlowInputs, TrainingProgress, TruthAt,
    Waveform,
};
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};

use super::carrier_inputs::CarrierInputs;
use super::model_residual::ModelResidual;
use super::{Estimate, ProgressSink};

/// Returns the configuration with the segment's own white noise if it states none.
pub fn with_measured_noise(config: PinnConfig, segment: &Segment) -> PinnConfig {
    let measured = || WhiteNoise::measure(segment).measured();
    PinnConfig {
        noise: config.noise.or_else(measured),
        ..config
    }
}

/// Adapts the configuration to a moving carrier, for the mains half-cycle that begins at `crossing_s` in seconds.
pub fn follow_carrier(config: &mut PinnConfig, carrier: &CarrierInputs, crossing_s: f64) {
    // R and L are interpolated linearly between the slow times.
    const SLOW_POINTS: usize = 4;
    let intervals = carrier.intervals.min(MAX_INTERVALS);
    config.spline_intervals = config.spline_intervals.max(intervals);
    config.slow_points = config.slow_points.max(SLOW_POINTS * intervals);
    // Start values belong to other inputs.
    config.start = None;
    config.inputs = Some(SlowInputs {
        t0_s: carrier.t0_s - crossing_s,
        dt_s: carrier.dt_s,
        functions: carrier.functions.clone(),
    });
}

/// Most spline intervals of a half-cycle that the network accepts.
const MAX_INTERVALS: usize = 400;

/// Waveform of the samples `from` up to `to`, within the mains half-cycle that begins at `crossing_s` in seconds, from which
/// its time counts.
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

/// Trains on the samples of a mains half-cycle and appends the result to the estimate.
///
/// # Errors
/// [`PinnError`] of [`IdentifyTask::run`]; the estimate is then unchanged.
pub fn identify_half_cycle(
    segment: &Segment,
    range: (usize, usize),
    config: &PinnConfig,
    checkpoint: Option<&Path>,
    sink: &mut ProgressSink<'_>,
    estimate: &mut Estimate,
) -> Result<Identification, PinnError> {
    let crossing_s = segment.crossing_of_s(range);
    let truth_at = |t_s: f64| {
        let at = sink.truth.and_then(|truth| truth.at(t_s + crossing_s));
        at.unwrap_or((f64::NAN, f64::NAN))
    };
    let task = IdentifyTask {
        window: waveform(segment, range, crossing_s),
        config,
        truth: sink.truth.map(|_| &truth_at as TruthAt<'_>),
        checkpoint,
    };
    let identified = task.run(&mut |p| (sink.report)(state(p)))?;
    append(&identified, crossing_s, estimate);
    estimate.notes.push(format!(
        "half-cycle from {crossing_s:.4} s: {} steps, {}; {}",
        identified.iterations,
        identified.stopped_because,
        physics(&identified)
    ));
    Ok(identified)
}

/// Appends the result for the half-cycle that begins at `crossing_s` in seconds, and a remark if the training did not
/// converge.
pub fn append(identified: &Identification, crossing_s: f64, estimate: &mut Estimate) {
    let times_s = identified.t_s.iter().map(|t| t + crossing_s);
    estimate.t_s.extend(times_s);
    estimate.r_ohm.extend(&identified.r_ohm);
    estimate.l_h.extend(&identified.l_h);
    estimate.r_sigma_ohm.extend(&identified.r_sigma_ohm);
    estimate.l_sigma_h.extend(&identified.l_sigma_h);
    estimate.r_power_ohm.extend(&identified.r_power_ohm);
    model_residual(identified).note_in(estimate);
    if !identified.stopped_because.is_converged() {
        let text = format!(
            "the fit of the half-cycle from {crossing_s:.4} s did not converge ({}, {} steps)",
            identified.stopped_because, identified.iterations
        );
        let remark = Remark::new("not_converged", Severity::Error, text);
        estimate.remarks.push(remark);
    }
}

fn model_residual(identified: &Identification) -> ModelResidual {
    let mut residual = ModelResidual::default();
    for (k, chi2) in identified.chi2.iter().enumerate() {
        let relative = [
            identified.r_sigma_ohm[k] / identified.r_ohm[k],
            identified.l_sigma_h[k] / identified.l_h[k],
        ];
        residual.add(identified.i_amplitude_a[k].powi(2), *chi2, relative);
    }
    residual
}

/// State of the training as text, with the errors of R and L if the truth is known.
fn state(p: &TrainingProgress) -> String {
    let (step, l_f, l_i) = (p.iteration, p.l_f, p.l_i);
    let errors = p
        .mre_pct
        .map_or(String::new(), |(r, l)| format!(", off {r:.2}/{l:.2} %"));
    format!("step {step}, L_f {l_f:.1e}, L_i {l_i:.1e}{errors}")
}

/// P/I_rms² at the crest beside R of the fundamental, and the order of the impedance law.
fn physics(identified: &Identification) -> String {
    let largest = |a: &usize, b: &usize| {
        let i = &identified.i_amplitude_a;
        i[*a].total_cmp(&i[*b])
    };
    let crest = (0..identified.i_amplitude_a.len())
        .max_by(largest)
        .unwrap_or(0);
    let (r, p) = (identified.r_ohm[crest], identified.r_power_ohm[crest]);
    let order = match identified.impedance_order {
        0.0 => String::new(),
        n => format!(", impedance order {n:.2}"),
    };
    format!("at the crest R {r:.3} Ω, P/I_rms² {p:.3} Ω{order}")
}
