//! Identification with a moving carrier: the samples are warped to a time in which the frequency is constant
//! ([`ihd_signal::carrier`]), and the estimate is converted back to the capture's clock.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::carrier::{Carrier, HannFrames};
use ihd_signal::segment::MIN_PERIODS;
use ihd_signal::warp::Warp;
use ihd_signal::{Remark, Segment, Severity};

use super::carrier_inputs::CarrierInputs;
use super::steps::piece_left_out;
use super::trajectory::TrajectoryCursor;
use super::{Estimate, IdentifyError, IdentifyOptions, Method, reconstruction};

/// Detects a segment's carrier; `None` if it does not move, or the method does not assume it constant.
pub(super) fn detect(method: Method, segment: &Segment) -> Option<Carrier> {
    let frames = takes_constant(method).then(|| HannFrames::compute(segment))??;
    moving(&frames)
}

/// Returns `true` if the method assumes a constant carrier.
pub(super) fn takes_constant(method: Method) -> bool {
    matches!(method, Method::LeastSquares | Method::Lockin | Method::Pinn)
}

/// Carrier of a segment if it moves, else `None`.
pub(super) fn moving(frames: &HannFrames) -> Option<Carrier> {
    Carrier::from_frames(frames).filter(Carrier::moves)
}

/// Parts of a segment that are warped separately: those that the method treats separately, so that mains zero crossings keep
/// their times.
fn parts(method: Method, segment: &Segment) -> Vec<Range<usize>> {
    match method {
        Method::LeastSquares | Method::Pinn => {
            let halves = segment.half_cycles().into_iter();
            halves.map(|(from, to)| from..to).collect()
        }
        _ => std::iter::once(0..segment.len()).collect(),
    }
}

/// Spline intervals of the phasors, and of R and L, per cycle of a sweep; with four and a half they lose a part in a thousand
/// of a sine.
const PHASOR_INTERVALS: f64 = 9.0;
const IMPEDANCE_INTERVALS: f64 = 4.5;

/// Options for R and L that follow the frequency, and a current that follows both.
fn quickened(settings: &IdentifyOptions, carrier: &Carrier, half_cycle_s: f64) -> IdentifyOptions {
    let sweep = carrier.sweep();
    let sweeps = sweep.rate_hz * half_cycle_s;
    let needed = |per_sweep: f64| (per_sweep * sweeps).ceil() as usize;
    let mut quick = settings.clone();
    let of = &mut quick.least_squares;
    of.phasor_intervals = of.phasor_intervals.max(needed(PHASOR_INTERVALS));
    of.impedance_intervals = of.impedance_intervals.max(needed(IMPEDANCE_INTERVALS));
    // R and ωL follow the frequency or its root: second difference over an interval.
    let angle = TAU * sweeps / of.impedance_intervals as f64;
    of.bend += sweep.deviation_hz / sweep.mean_hz * angle * angle;
    quick
}

/// Inputs of the network for the carrier: its frequency and rate of change, over the warped samples.
fn inputs(warp: &Warp<'_>, warped: &Segment, carrier: &Carrier) -> CarrierInputs {
    let sweep = carrier.sweep();
    let dt_s = 1.0 / warped.f_sw_hz;
    let count = (warped.len() as f64 * warped.dt_s / dt_s).ceil() as usize + 1;
    let at = |k: usize| warp.time_s(warped.t0_s + k as f64 * dt_s);
    let off = |t_s: f64| (carrier.hz(t_s) - sweep.mean_hz) / sweep.deviation_hz;
    // Averaged over four periods, so that the step of the tracked frequency has no effect.
    let slope = |t_s: f64| {
        let beside_s = 2.0 * dt_s;
        (off(t_s + beside_s) - off(t_s - beside_s)) / (2.0 * beside_s * TAU * sweep.rate_hz)
    };
    let function = |of: &dyn Fn(f64) -> f64| (0..count).map(|k| of(at(k))).collect();
    CarrierInputs {
        t0_s: warped.t0_s,
        dt_s,
        functions: vec![function(&off), function(&slope)],
        intervals: (PHASOR_INTERVALS * sweep.rate_hz * warped.half_cycle_s()).ceil() as usize,
    }
}

/// Identifies a segment with a moving carrier, part by part. `identify` receives the warped samples, and a function that gives the
/// capture's time at a warped one.
///
/// # Errors
/// Error of the last part if none could be identified.
pub(super) fn identify(
    method: Method,
    segment: &Segment,
    carrier: &Carrier,
    settings: &IdentifyOptions,
    mut identify: impl FnMut(
        &Segment,
        &IdentifyOptions,
        &dyn Fn(f64) -> f64,
    ) -> Result<Estimate, IdentifyError>,
) -> Result<Estimate, IdentifyError> {
    let mut whole = Estimate::new(method, carrier.mean_hz());
    whole.v_hat_v = vec![0.0; segment.len()];
    whole.i_hat_a = vec![0.0; segment.len()];
    let mut settings = quickened(settings, carrier, segment.half_cycle_s());
    let (mut failed, mut left_out) = (None, Vec::new());
    for range in parts(method, segment) {
        let warp = Warp::new(segment, carrier, range.clone());
        let warped = warp.samples();
        let checked = warped.check().map_err(IdentifyError::from);
        let result = checked.and_then(|()| {
            if method == Method::Pinn {
                settings.pinn.carrier = Some(inputs(&warp, &warped, carrier));
            }
            identify(&warped, &settings, &|t_s| warp.time_s(t_s))
        });
        match result {
            Ok(mut found) => {
                reconstruction::complete(&warped, &mut found);
                take_waveforms(&mut whole, range, &found, &warp);
                append(&mut whole, found, &warp);
            }
            Err(e) => {
                // At a constant carrier, too, a stub of a half-cycle at an end is left out without a remark.
                if warped.periods() >= MIN_PERIODS {
                    let between_s = (segment.t_s(range.start), segment.t_s(range.end));
                    let remark = piece_left_out("mains zero crossings", between_s, &warped, &e);
                    whole.remarks.push(remark);
                }
                left_out.push(range);
                failed = Some(e);
            }
        }
    }
    if let (true, Some(e)) = (whole.t_s.is_empty(), failed) {
        return Err(e);
    }
    for range in left_out {
        let warp = Warp::new(segment, carrier, range.clone());
        let bridge = bridge(&whole, &warp);
        take_waveforms(&mut whole, range, &bridge, &warp);
    }
    reconstruction::complete(segment, &mut whole);
    whole.remarks.push(remark(carrier));
    Ok(whole)
}

/// R and L of a part that was left out, between those before and after it, with the waveforms that they imply: as beside steps of the
/// load.
fn bridge(whole: &Estimate, warp: &Warp<'_>) -> Estimate {
    let warped = warp.samples();
    let mut bridge = Estimate::new(whole.method, warped.f_sw_hz);
    if let Some(mut trajectory) = TrajectoryCursor::from(whole, f64::NEG_INFINITY) {
        for k in 0..=warped.periods() as usize {
            let warped_s = warped.t0_s + k as f64 / warped.f_sw_hz;
            let t_s = warp.time_s(warped_s);
            let (r, l) = trajectory.r_l(t_s);
            bridge.push(warped_s, (r, l * warp.rate(t_s)), (0.0, 0.0));
        }
    }
    reconstruction::complete(&warped, &mut bridge);
    bridge
}

/// Takes the waveforms of a part, which are in warped time, into the range of its samples.
fn take_waveforms(whole: &mut Estimate, range: Range<usize>, part: &Estimate, warp: &Warp<'_>) {
    whole.v_hat_v[range.clone()].copy_from_slice(&warp.unwarped(&part.v_hat_v));
    whole.i_hat_a[range].copy_from_slice(&warp.unwarped(&part.i_hat_a));
}

/// Converts an estimate from warped time to the capture's clock, and appends it.
fn append(whole: &mut Estimate, part: Estimate, warp: &Warp<'_>) {
    let from = whole.t_s.len();
    whole.t_s.extend(part.t_s.iter().map(|t| warp.time_s(*t)));
    let rates: Vec<f64> = whole.t_s[from..].iter().map(|t| warp.rate(*t)).collect();
    let over_rate = |x: &[f64]| -> Vec<f64> { x.iter().zip(&rates).map(|(x, r)| x / r).collect() };
    whole.l_h.extend(over_rate(&part.l_h));
    whole.l_sigma_h.extend(over_rate(&part.l_sigma_h));
    whole.r_ohm.extend(part.r_ohm);
    whole.r_sigma_ohm.extend(part.r_sigma_ohm);
    whole.r_power_ohm.extend(part.r_power_ohm);
    whole.elapsed += part.elapsed;
    whole.notes.extend(part.notes);
    whole.remarks.extend(part.remarks);
}

fn remark(carrier: &Carrier) -> Remark {
    let sweep = carrier.sweep();
    let text = format!(
        "the switching frequency moves by {:.2} kHz around {:.2} kHz: it is followed, and R and L are those at the \
         frequency of each instant",
        sweep.deviation_hz * 1e-3,
        sweep.mean_hz * 1e-3
    );
    Remark::new("carrier_followed", Severity::Info, text).with(sweep.deviation_hz, None)
}

#[cfg(test)]
mod tests {
    use ihd_signal::noise::WhiteNoise;
    use ihd_sim::pot::SimulatedPot;
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::sensing::Rate;
    use ihd_sim::recording::settings::{CaptureSpec, CarrierSweep, LoadKind};

    use super::*;
    use crate::least_squares;

    /// Three half-cycles of the empty coil, whose R and L hardly change: those before and after the middle one describe it, too. Without
    /// waveforms there, a third of each signal would be missing.
    #[test]
    fn a_half_cycle_without_r_and_l_is_reported_and_bridged() {
        let mut spec = CaptureSpec {
            f_sw_hz: 50e3,
            load: LoadKind::Behavioural,
            pot: SimulatedPot::NONE,
            duration_s: 30e-3,
            sweep: Some(CarrierSweep {
                deviation_hz: 1e3,
                rate_hz: 100.0,
            }),
            ..CaptureSpec::default()
        };
        spec.sensing.rate = Rate::Hz(11.37e6);
        let recording = record(&spec, |_| ()).unwrap();
        let capture = recording.capture("sweep");
        let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect();
        let (v_v, i_a) = (wide(&capture.v_v), wide(&capture.i_a));
        let segment = recording.clean_segment().with_samples(v_v, i_a);
        let method = Method::LeastSquares;
        let carrier = detect(method, &segment).expect("a carrier that moves");
        let half_s = segment.half_cycle_s();
        let middle = segment.t0_s + half_s..segment.t0_s + 2.0 * half_s;
        let settings = IdentifyOptions::default();
        let found = identify(
            method,
            &segment,
            &carrier,
            &settings,
            |warped, settings, _| {
                if middle.contains(&warped.t_s(warped.len() / 2)) {
                    let why = "for the test".to_owned();
                    return Err(IdentifyError::Unfit { method, why });
                }
                let noise = WhiteNoise::measure(warped);
                least_squares::identify(warped, noise, &settings.least_squares)
            },
        );
        let found = found.expect("two half-cycles");
        let left_out = found.remarks.iter().filter(|r| r.code == "piece_left_out");
        let texts: Vec<&str> = left_out.map(|r| r.text.as_str()).collect();
        assert!(
            matches!(texts[..], [text] if text.contains("for the test")),
            "{texts:?}"
        );
        let (v, i) = (found.nmse_v_pct.unwrap(), found.nmse_i_pct.unwrap());
        assert!(v < 5.0 && i < 5.0, "{v} {i}");
    }
}
