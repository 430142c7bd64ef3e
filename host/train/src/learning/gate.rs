//! The gate: which identified window may teach the lookup.

use ihd_pinn::Identified;
use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE, plausible};

/// Largest NMSE of the reconstructed current, in percent. White noise of 30 dB alone is 0.1 %, of
/// 20 dB 1 %; the current's harmonics beyond the seventh are below 0.1 %.
pub const MAX_NMSE_I_PCT: f64 = 1.5;

/// Largest NMSE of the reconstructed voltage, in percent. The edges of the square wave beyond the
/// seventh harmonic are 2-4 % of its energy far from resonance and are not modelled.
pub const MAX_NMSE_V_PCT: f64 = 8.0;

/// Largest mean standard deviation of R and of L, in percent of the value, weighted with the squared
/// current. White noise of 30 dB on a window of the device gives 0.2-0.26 % and 0.1-0.15 %,
/// of 20 dB 0.5-0.8 % and 0.3-0.4 %.
pub const MAX_SIGMA_PCT: f64 = 3.0;

/// What the gate says.
#[derive(Clone, Debug, PartialEq)]
pub enum GateVerdict {
    /// May teach.
    Pass,
    /// May not, and why.
    Reject(String),
}

/// Judges an identified window.
pub fn judge(identified: &Identified) -> GateVerdict {
    let within = |value: f64, codes: &core::ops::RangeInclusive<u16>, unit: f64| {
        let (low, high) = (f64::from(*codes.start()), f64::from(*codes.end()));
        (low * unit..=high * unit).contains(&value)
    };
    let r_ok = |r: &f64| within(*r, &plausible::R_CODES, OHM_PER_CODE);
    let l_ok = |l: &f64| within(*l, &plausible::L_CODES, HENRY_PER_CODE);
    if !identified.stopped_because.is_converged() {
        return GateVerdict::Reject(format!(
            "the fit did not converge ({}, {} steps)",
            identified.stopped_because, identified.iterations
        ));
    }
    for (name, nmse, limit) in [
        ("current", identified.nmse_i_pct, MAX_NMSE_I_PCT),
        ("voltage", identified.nmse_v_pct, MAX_NMSE_V_PCT),
    ] {
        if nmse.is_nan() || nmse > limit {
            return GateVerdict::Reject(format!(
                "the {name} is reproduced to {nmse:.2} % only (limit {limit} %)"
            ));
        }
    }
    if let Some((r, l)) = identified.relative_sigma_pct()
        && !(r <= MAX_SIGMA_PCT && l <= MAX_SIGMA_PCT)
    {
        return GateVerdict::Reject(format!(
            "noise leaves R uncertain by {r:.1} % and L by {l:.1} % (limit {MAX_SIGMA_PCT} %)"
        ));
    }
    match (
        identified.r_ohm.iter().all(r_ok),
        identified.l_h.iter().all(l_ok),
    ) {
        (true, true) => GateVerdict::Pass,
        (false, _) => GateVerdict::Reject("R leaves 0.02-15.9 ohm".into()),
        (_, false) => GateVerdict::Reject("L leaves 2-63.9 µH".into()),
    }
}
