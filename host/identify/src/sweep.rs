//! A carrier that moves: the estimator is given samples in warped time, in which it stands still
//! ([`ihd_signal::carrier`]), and what it finds is put back on the capture's clock.

use std::f64::consts::TAU;
use std::ops::Range;

use ihd_signal::carrier::{Carrier, Warp};
use ihd_signal::{Remark, Segment, Severity};

use super::pinn::CarrierInputs;
use super::{Estimate, IdentifyError, Method, Settings, reconstruction};

/// The carrier of a segment, where it moves and the method takes it as constant.
pub(super) fn of(method: Method, segment: &Segment) -> Option<Carrier> {
    takes_constant(method).then(|| moving(segment)).flatten()
}

/// Whether the method takes the carrier as constant.
pub(super) fn takes_constant(method: Method) -> bool {
    matches!(method, Method::LeastSquares | Method::Lockin | Method::Pinn)
}

/// The carrier of a segment, where it moves.
pub(super) fn moving(segment: &Segment) -> Option<Carrier> {
    Carrier::of(segment).filter(Carrier::moves)
}

/// Parts that are warped for themselves: those that the method takes for themselves, so that mains zero crossings stay
/// where they are.
fn parts(method: Method, segment: &Segment) -> Vec<Range<usize>> {
    match method {
        Method::LeastSquares | Method::Pinn => {
            let halves = segment.half_cycles().into_iter();
            halves.map(|(from, to)| from..to).collect()
        }
        _ => std::iter::once(0..segment.len()).collect(),
    }
}

/// Spline intervals of the phasors, and of R and L, that a sweep wants while it goes up and down once: they lose a part in
/// a thousand of a sine with four and a half.
const PHASOR_INTERVALS: f64 = 9.0;
const IMPEDANCE_INTERVALS: f64 = 4.5;

/// Settings for R and L that follow the frequency, and a current that follows both.
fn quickened(settings: &Settings, carrier: &Carrier, half_cycle_s: f64) -> Settings {
    let sweep = carrier.sweep();
    let sweeps = sweep.rate_hz * half_cycle_s;
    let wanted = |per_sweep: f64| (per_sweep * sweeps).ceil() as usize;
    let mut quick = settings.clone();
    let of = &mut quick.least_squares;
    of.phasor_intervals = of.phasor_intervals.max(wanted(PHASOR_INTERVALS));
    of.impedance_intervals = of.impedance_intervals.max(wanted(IMPEDANCE_INTERVALS));
    // R and ωL go with the frequency or its root: their second difference over an interval.
    let angle = TAU * sweeps / of.impedance_intervals as f64;
    of.bend += sweep.deviation_hz / sweep.mean_hz * angle * angle;
    quick
}

/// What a network is told of the carrier: its frequency and how fast that moves, through the warped samples.
fn inputs(warp: &Warp<'_>, warped: &Segment, carrier: &Carrier) -> CarrierInputs {
    let sweep = carrier.sweep();
    let dt_s = 1.0 / warped.f_sw_hz;
    let count = (warped.len() as f64 * warped.dt_s / dt_s).ceil() as usize + 1;
    let at = |k: usize| warp.time_s(warped.t0_s + k as f64 * dt_s);
    let off = |t_s: f64| (carrier.hz(t_s) - sweep.mean_hz) / sweep.deviation_hz;
    // Over four periods, a step of what follows the carrier is no matter.
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

/// Identifies a segment whose carrier moves, part by part with `identify`, which sees a constant one and
/// is told the capture's time at a warped one.
///
/// # Errors
/// The last part's where none could be identified.
pub(super) fn identify(
    method: Method,
    segment: &Segment,
    carrier: &Carrier,
    settings: &Settings,
    mut identify: impl FnMut(
        &Segment,
        &Settings,
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

/// Puts what was found in warped time on the capture's clock.
fn append(whole: &mut Estimate, found: Estimate, warp: &Warp<'_>) {
    let from = whole.t_s.len();
    whole.t_s.extend(found.t_s.iter().map(|t| warp.time_s(*t)));
    let rates: Vec<f64> = whole.t_s[from..].iter().map(|t| warp.rate(*t)).collect();
    let over_rate = |x: &[f64]| -> Vec<f64> { x.iter().zip(&rates).map(|(x, r)| x / r).collect() };
    whole.l_h.extend(over_rate(&found.l_h));
    whole.l_sigma_h.extend(over_rate(&found.l_sigma_h));
    whole.r_ohm.extend(found.r_ohm);
    whole.r_sigma_ohm.extend(found.r_sigma_ohm);
    whole.r_power_ohm.extend(found.r_power_ohm);
    whole.elapsed += found.elapsed;
    whole.notes.extend(found.notes);
    whole.remarks.extend(found.remarks);
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
