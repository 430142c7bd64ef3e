//! Self-calibration of a capture or a segment: from its stretches to the result.

use std::f64::consts::TAU;

use ihd_signal::segment::Segment;
use ihd_signal::{Capture, Load, RawSamples, Samples};

use super::choose::{MIN_SKEW_GAIN, ModelChoice};
use super::edges::Stretch;
use super::error::BlindError;
use super::fit::{FittedValue, Model};
use super::samples::StretchSamples;
use super::self_calibration::{MIN_LAG_SIGMAS, ModelTests, SelfCalibration, SensorResponse};
use super::settle::{SettledChoice, settle};
use crate::clipping::level_step;
use crate::{Channel, Finding, Severity, Survey};

/// Step between a channel's levels, as a share of its rms value, above which rounding is taken for a lag: 6 bits have 9 %, 7 have 4.
const COARSE_STEP_SHARE: f64 = 0.06;

/// Noise over the step that hides it; rounding alone is measured as .29.
const HIDING_NOISE_RATIO: f64 = 0.6;

/// Lag in seconds that cables and samplers do not cause.
const LONG_S: f64 = 100e-9;

/// Most samples of a stretch: 20 ms at 125 MS/s.
const MAX_STRETCH_SAMPLES: usize = 2_500_000;

/// Estimates the errors of a capture's sensors.
///
/// # Errors
/// [`BlindError`] if no inverter with a series capacitor is visible, or too little of it.
pub fn estimate(
    capture: &Capture,
    survey: &Survey,
    known_capacitance_f: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    // A negative R is no obstacle, because a lag causes it.
    let unfit = |f: &&Finding| {
        matches!(f, Finding::Swapped { .. } | Finding::Dead { .. })
            || (f.severity() == Severity::Error && matches!(f, Finding::Clipping { .. }))
    };
    if let Some(finding) = survey.findings.iter().find(unfit) {
        return Err(BlindError::Unfit(finding.clone()));
    }
    let channels = [
        (Channel::Voltage, &capture.v_v, &survey.voltage),
        (Channel::Current, &capture.i_a, &survey.current),
    ];
    for (channel, x, numbers) in channels {
        let step = level_step(x).unwrap_or(0.0);
        // Noise of more than half a step makes noise of the rounding.
        let is_hidden = numbers
            .noise
            .is_some_and(|sigma| sigma > HIDING_NOISE_RATIO * step);
        if step > COARSE_STEP_SHARE * numbers.rms && !is_hidden {
            return Err(BlindError::TooCoarse {
                channel,
                step,
                of_rms_pct: 100.0 * step / numbers.rms,
            });
        }
    }
    let sign = if survey.wiring.inverted { -1.0 } else { 1.0 };
    let mut room = MAX_STRETCH_SAMPLES;
    let mut stretches = Vec::new();
    // The longest spans first, because the number of samples is limited.
    let mut spans: Vec<_> = survey.spans.iter().collect();
    spans.sort_by_key(|s| std::cmp::Reverse(s.samples));
    for span in &spans {
        let taken = span.samples.min(room);
        room -= taken;
        let range = span.first..span.first + taken;
        let (Some(v), Some(i)) = (capture.v_v.get(range.clone()), capture.i_a.get(range)) else {
            continue;
        };
        stretches.push(Stretch {
            v_v: StretchSamples::captured(v, 1.0),
            i_a: StretchSamples::captured(i, sign),
            dt_s: span.dt_s,
            f_sw_hz: span.f_sw_hz,
        });
    }
    let strongest = spans.first();
    let f_sw_hz = strongest.map_or(45e3, |s| s.f_sw_hz);
    let load = strongest.and_then(|s| s.load);
    judged(&stretches, f_sw_hz, load, known_capacitance_f, None)
}

/// Estimates the errors of the sensors from a segment, for example a device's window. `settling_s` is the time constant in
/// seconds of a filter that both channels share.
///
/// # Errors
/// Errors of [`estimate`].
pub fn estimate_segment(
    segment: &Segment,
    load: Option<Load>,
    known_capacitance_f: Option<f64>,
    settling_s: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    let n = segment
        .v_v
        .len()
        .min(segment.i_a.len())
        .min(MAX_STRETCH_SAMPLES);
    // The offset of single-precision samples is part of their mean.
    let of = |x| match Samples::raw(x) {
        RawSamples::Singles(x, _) => StretchSamples::captured(&x[..n], 1.0),
        RawSamples::Doubles(x) => StretchSamples::copied(&x[..n]),
    };
    let one = [Stretch {
        v_v: of(&segment.v_v),
        i_a: of(&segment.i_a),
        dt_s: segment.dt_s,
        f_sw_hz: segment.f_sw_hz,
    }];
    judged(&one, segment.f_sw_hz, load, known_capacitance_f, settling_s)
}

fn judged(
    stretches: &[Stretch<'_>],
    f_sw_hz: f64,
    load: Option<Load>,
    known_capacitance_f: Option<f64>,
    settling_s: Option<f64>,
) -> Result<SelfCalibration, BlindError> {
    let settled = settle(stretches, settling_s)?;
    let (chosen, v_tau_s) = (&settled.chosen, settled.v_tau_s);
    let e = chosen.fit.elastance;
    let omega = TAU * f_sw_hz;
    if e.value < MIN_LAG_SIGMAS * e.sigma || e.value <= 0.0 {
        // The smallest voltage of a capacitor that would have been visible, against the bridge's.
        let hidden_v = MIN_LAG_SIGMAS * e.sigma.max(e.value.abs()) * chosen.i_a / omega;
        return Err(match hidden_v < HIDDEN_V {
            true => BlindError::BridgeVoltage,
            false => BlindError::TooNoisy {
                per_farad: e.value,
                sigma: e.sigma,
            },
        });
    }
    let response = response(&settled);
    let mut lag_s = lag(chosen, omega);
    lag_s.value -= v_tau_s + settled.skew_s;
    let cost_pct = load.map(|z| {
        let angle = omega * lag_s.value.abs();
        let (r, x) = (z.r_ohm.abs(), omega * z.l_h);
        (100.0 * angle * x / r, 100.0 * angle * r / x)
    });
    Ok(SelfCalibration {
        capacitance_f: FittedValue {
            value: 1.0 / e.value,
            sigma: e.sigma / (e.value * e.value),
        },
        lag_s,
        as_skew_s: FittedValue {
            value: chosen.skew_s.value + v_tau_s + settled.skew_s,
            sigma: chosen.skew_s.sigma,
        },
        response,
        told_apart: v_tau_s > 0.0
            || (settled.skew_s != 0.0 && chosen.is_flat())
            || chosen.beyond_skew > MIN_SKEW_GAIN,
        tests: ModelTests {
            misfit: chosen.fit.misfit.share,
            flat: chosen.is_flat(),
            bend: chosen.bend,
            sides_agree: chosen.side.is_none(),
        },
        known_capacitance_f,
        cost_pct,
        plateaus: chosen.plateaus,
        samples: chosen.samples,
        i_a: chosen.i_a,
    })
}

/// Amplitude of a capacitor's voltage in volt that would have been visible.
const HIDDEN_V: f64 = 10.0;

fn response(settled: &SettledChoice) -> SensorResponse {
    let (chosen, v_tau_s, before_s) = (&settled.chosen, settled.v_tau_s, settled.skew_s);
    if v_tau_s > 0.0 {
        return SensorResponse::SlowVoltage { tau_s: v_tau_s };
    }
    let (t_s, corner_hz) = (chosen.fit.time_s.value, chosen.fit.droop.value / TAU);
    let droop = |skew_s, tau_s| SensorResponse::Droop {
        corner_hz,
        skew_s: before_s + skew_s,
        tau_s,
    };
    let skew = |skew_s| SensorResponse::Skew {
        skew_s: before_s + skew_s,
    };
    match chosen.fit.model {
        Model::Right if before_s == 0.0 => SensorResponse::Right,
        Model::Right => skew(0.0),
        Model::Skew => skew(t_s),
        // So long a lag comes from a probe rather than a delay, unless the delay explains more.
        Model::SlowCurrent
            if before_s == 0.0 && (chosen.beyond_skew > MIN_SKEW_GAIN || t_s > LONG_S) =>
        {
            SensorResponse::SlowCurrent { tau_s: t_s }
        }
        // A skew explains it as well and needs no filter.
        Model::SlowCurrent => skew(-t_s),
        Model::Droop => droop(0.0, 0.0),
        Model::SkewAndDroop => droop(t_s, 0.0),
        Model::SlowCurrentAndDroop => droop(0.0, t_s),
    }
}

fn lag(chosen: &ModelChoice, omega: f64) -> FittedValue {
    let (time, skew) = (chosen.fit.time_s, chosen.skew_s);
    let droop_s = chosen.fit.droop.value / (omega * omega);
    let value = match chosen.fit.model {
        Model::Right | Model::Skew => -skew.value,
        Model::SlowCurrent => time.value,
        Model::SlowCurrentAndDroop => time.value - droop_s,
        Model::Droop | Model::SkewAndDroop => -time.value - droop_s,
    };
    // Time and corner are estimated together: their sum is as precise as a skew.
    FittedValue {
        value,
        sigma: skew.sigma,
    }
}
