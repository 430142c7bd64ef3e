//! One operating point: what the estimators say, beside the truth where it is known.

use ihd_link::Window;
use ihd_pinn::Identified;
use ihd_signal::Load;
use ihd_signal::truth::{Mre, Truth};
use serde::Serialize;

/// Mean relative errors in percent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Of R over the whole half-cycle.
    pub r_whole_pct: f64,
    /// Of L over the whole half-cycle.
    pub l_whole_pct: f64,
    /// Of R over the middle 80 %.
    pub r_middle_pct: f64,
    /// Of L over the middle 80 %.
    pub l_middle_pct: f64,
}

/// One operating point.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Power asked for, in watt; none in a replay.
    pub asked_w: Option<u16>,
    /// Power of the half-cycle before the window arrived, in watt; none in a replay.
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
    /// The network against the truth.
    pub pinn_errors: Option<Errors>,
    /// What all windows of this pot say, the map at this window's currents, against the truth.
    pub learned_errors: Option<Errors>,
    /// The firmware filter against the truth.
    pub ekf_errors: Option<Errors>,
    /// Time the network took, in seconds.
    pub training_s: f64,
    /// Optimiser steps.
    pub iterations: usize,
    /// Version of the lookup that this window led to.
    pub lookup_version: u32,
}

/// The crest of the current: its time and amplitude in seconds and ampere.
pub fn crest(identified: &Identified) -> (f64, f64) {
    identified
        .t_s
        .iter()
        .copied()
        .zip(identified.i_amplitude_a.iter().copied())
        .fold((0.0, 0.0), |best, p| if p.1 > best.1 { p } else { best })
}

/// The firmware filter's track: (time, R, L) in seconds, ohm, henry.
pub fn track(window: &Window) -> impl Iterator<Item = (f64, f64, f64)> {
    let entries = window.trajectory.iter().enumerate();
    entries.map(|(k, e)| (window.trajectory_time_s(k), e.r.ohm(), e.l.henry()))
}

/// Errors of estimates over a half-cycle of the given duration in seconds.
pub fn errors(
    truth: &Truth,
    estimates: impl Iterator<Item = (f64, f64, f64)> + Clone,
    half_cycle_s: f64,
) -> Option<Errors> {
    let whole = Mre::of(truth, estimates.clone(), 0.0, half_cycle_s)?;
    let middle = Mre::of(truth, estimates, 0.1 * half_cycle_s, 0.9 * half_cycle_s)?;
    Some(Errors {
        r_whole_pct: whole.r_pct,
        l_whole_pct: whole.l_pct,
        r_middle_pct: middle.r_pct,
        l_middle_pct: middle.l_pct,
    })
}

/// Compares a window's estimates with each other and with the truth; `power` is the asked and the
/// delivered one, in watt.
pub fn compare(
    window: &Window,
    identified: &Identified,
    truth: Option<&Truth>,
    power: Option<(u16, f64)>,
) -> Point {
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
    Point {
        asked_w: power.map(|p| p.0),
        delivered_w: power.map(|p| p.1),
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
