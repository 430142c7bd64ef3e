//! Identification with a moving carrier: the samples are warped to a time in which the frequency is constant
//! ([`ihd_signal::carrier`]), and the estimate is converted back to the capture's clock.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::carrier::{Carrier, HannFrames};
use ihd_signal::warp::Warp;
use ihd_signal::{Remark, Segment, Severity};

use super::carrier_inputs::CarrierInputs;
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
    let mut failed = None;
    for range in parts(method, segment) {
        let warp = Warp::new(segment, carrier, range.clone());
        let warped = warp.samples();
        if let Err(short) = warped.check() {
            failed = Some(short.into());
            continue;
        }
        if method == Method::Pinn {
            settings.pinn.carrier = Some(inputs(&warp, &warped, carrier));
        }
        match identify(&warped, &settings, &|t_s| warp.time_s(t_s)) {
            Ok(mut found) => {
                reconstruction::complete(&warped, &mut found);
                whole.v_hat_v[range.clone()].copy_from_slice(&warp.unwarped(&found.v_hat_v));
                whole.i_hat_a[range].copy_from_slice(&warp.unwarped(&found.i_hat_a));
                append(&mut whole, found, &warp);
            }
            Err(e) => failed = Some(e),
        }
    }
    if let (true, Some(e)) = (whole.t_s.is_empty(), failed) {
        return Err(e);
    }
    reconstruction::complete(segment, &mut whole);
    whole.remarks.push(remark(carrier));
    Ok(whole)
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
