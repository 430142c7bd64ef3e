//! Report of one operating point: the estimators' results, and the truth if it is known.

use ihd_link::Window;
use ihd_pinn::Identification;
use ihd_signal::Load;
use ihd_signal::truth::{Mre, Truth};
use serde::Serialize;

use crate::learning::anti_alias_loss;

/// Mean relative errors in percent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RelativeErrors {
    /// Error of R over the whole half-cycle.
    pub r_whole_pct: f64,
    /// Error of L over the whole half-cycle.
    pub l_whole_pct: f64,
    /// Error of R over the middle 80 % of the half-cycle.
    pub r_middle_pct: f64,
    /// Error of L over the middle 80 % of the half-cycle.
    pub l_middle_pct: f64,
}

/// Results at one operating point.
#[derive(Clone, Debug, Serialize)]
pub struct PointReport {
    /// Requested power in watt; `None` in a replay.
    pub asked_w: Option<u16>,
    /// Mean power in watt of the window's half-cycle: that of a burst where bursts make the power; `None` in a replay.
    pub delivered_w: Option<f64>,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Number of the window.
    pub window_seq: u32,
    /// The network's R and L at the crest.
    pub pinn: Load,
    /// The firmware filter's R and L at the crest.
    pub ekf: Option<Load>,
    /// The simulation's R and L at the crest.
    pub truth: Option<Load>,
    /// Errors of the network against the truth.
    pub pinn_errors: Option<RelativeErrors>,
    /// Errors of the map, which holds all windows of this pot, at this window's currents.
    pub learned_errors: Option<RelativeErrors>,
    /// Errors of the firmware filter against the truth.
    pub ekf_errors: Option<RelativeErrors>,
    /// Time the network took, in seconds.
    pub training_s: f64,
    /// Optimiser steps.
    pub iterations: usize,
    /// Version of the lookup that this window led to.
    pub lookup_version: u32,
}

/// Returns time and amplitude of the current's crest, in seconds and ampere.
pub fn crest(identified: &Identification) -> (f64, f64) {
    identified
        .t_s
        .iter()
        .copied()
        .zip(identified.i_amplitude_a.iter().copied())
        .fold((0.0, 0.0), |best, p| if p.1 > best.1 { p } else { best })
}

/// Returns the firmware filter's (time, R, L) in seconds, ohm, henry.
pub fn track(window: &Window) -> impl Iterator<Item = (f64, f64, f64)> {
    let entries = window.trajectory.iter().enumerate();
    entries.map(|(k, e)| (window.trajectory_time_s(k), e.r.ohm(), e.l.henry()))
}

/// Computes the errors of estimates over a half-cycle of the given duration in seconds.
pub fn errors(
    truth: &Truth,
    estimates: impl Iterator<Item = (f64, f64, f64)> + Clone,
    half_cycle_s: f64,
) -> Option<RelativeErrors> {
    let whole = Mre::compute(truth, estimates.clone(), 0.0, half_cycle_s)?;
    let middle = Mre::compute(truth, estimates, 0.1 * half_cycle_s, 0.9 * half_cycle_s)?;
    Some(RelativeErrors {
        r_whole_pct: whole.r_pct,
        l_whole_pct: whole.l_pct,
        r_middle_pct: middle.r_pct,
        l_middle_pct: middle.l_pct,
    })
}

/// Mean power of the window's half-cycle in watt, before the anti-alias filters.
fn mean_power_w(window: &Window) -> f64 {
    let segment = window.segment();
    let energy = |(v, i): (&f64, &f64)| v * i * segment.dt_s;
    let pairs = segment.v_v.iter().zip(segment.i_a.iter());
    let filtered_w = pairs.map(energy).sum::<f64>() / (f64::from(window.half_cycle_ns) * 1e-9);
    filtered_w * anti_alias_loss(f64::from(window.f_sw_hz)).powi(2)
}

/// Compares a window's estimates with each other and with the truth; `asked_w` is the requested power in watt.
pub fn compare(
    window: &Window,
    identified: &Identification,
    truth: Option<&Truth>,
    asked_w: Option<u16>,
) -> PointReport {
    let half_cycle_s = f64::from(window.half_cycle_ns) * 1e-9;
    let (crest_s, i_crest_a) = crest(identified);
    let nearest =
        track(window).min_by(|a, b| (a.0 - crest_s).abs().total_cmp(&(b.0 - crest_s).abs()));
    let network = identified
        .t_s
        .iter()
        .zip(&identified.r_ohm)
        .zip(&identified.l_h);
    let network = network.map(|((&t, &r), &l)| (t, r, l));
    let track: Vec<_> = track(window).collect();
    PointReport {
        asked_w,
        delivered_w: asked_w.map(|_| mean_power_w(window)),
        f_sw_hz: window.f_sw_hz,
        i_crest_a,
        window_seq: window.seq,
        pinn: Load {
            r_ohm: identified.r_at(crest_s),
            l_h: identified.l_at(crest_s),
        },
        ekf: nearest.map(|(_, r_ohm, l_h)| Load { r_ohm, l_h }),
        truth: truth
            .and_then(|t| t.at(crest_s))
            .map(|(r_ohm, l_h)| Load { r_ohm, l_h }),
        pinn_errors: truth.and_then(|t| errors(t, network, half_cycle_s)),
        learned_errors: None,
        ekf_errors: truth.and_then(|t| errors(t, track.iter().copied(), half_cycle_s)),
        training_s: identified.elapsed_s,
        iterations: identified.iterations,
        lookup_version: 0,
    }
}
