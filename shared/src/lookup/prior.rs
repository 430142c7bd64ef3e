//! The prior: a 21 cm ferromagnetic pot, the load that the firmware assumes before a lookup is pushed.
//!
//! R(I) = 3.0 + 4.0 / (1 + I / 9 A) ohm and L(I) = 20.5 + 18 / (1 + I / 10 A) µH at 45 kHz, which
//! pass through 6.6 → 3.7 ohm and 37 → 24 µH from 1 to 40 A (field model, docs/simulator.md);
//! with frequency R ∝ f^½ (skin depth) and L ∝ f^−0.3 (part of it is the gap's, which stays). That is over a coil of 23 turns; the
//! board's may have others ([`TURNS_RATIO`]).

use super::grid::{CURRENT_KNOTS_A, CURRENTS, FREQUENCIES};
use super::{HENRY_PER_CODE, OBSERVED_BYTES, OHM_PER_CODE, RlLookup};
use crate::hob::{F_SW_MAX_HZ, TURNS_RATIO};
use crate::units::{MicroOhm, PicoHenry};

/// R at 45 kHz by current knot, in lookup codes.
const R_AT_45K: [u16; CURRENTS] = at_45k(3.0, 4.0, 9.0, OHM_PER_CODE);

/// L at 45 kHz by current knot, in lookup codes.
const L_AT_45K: [u16; CURRENTS] = at_45k(20.5e-6, 18e-6, 10.0, HENRY_PER_CODE);

/// Codes of `saturated + magnetic / (1 + I / knee_a)` over 23 turns.
const fn at_45k(saturated: f64, magnetic: f64, knee_a: f64, per_code: f64) -> [u16; CURRENTS] {
    let mut codes = [0; CURRENTS];
    let mut i = 0;
    while i < CURRENTS {
        let of_23_turns = saturated + magnetic / (1.0 + CURRENT_KNOTS_A[i] * TURNS_RATIO / knee_a);
        codes[i] = (of_23_turns * TURNS_RATIO * TURNS_RATIO / per_code + 0.5) as u16;
        i += 1;
    }
    codes
}

/// (f / 45 kHz)^0.5 by frequency knot, 15-bit fixed point.
const R_FACTOR_Q15: [u32; FREQUENCIES] = [26755, 28697, 30779, 33013, 35409, 37978, 40734, 43691];

/// (f / 45 kHz)^−0.3 by frequency knot, 15-bit fixed point.
const L_FACTOR_Q15: [u32; FREQUENCIES] = [37006, 35483, 34022, 32622, 31279, 29992, 28757, 27573];

/// The prior as a lookup of version 0 with no cell observed.
pub const fn prior() -> RlLookup {
    let mut r = [[0; CURRENTS]; FREQUENCIES];
    let mut l = [[0; CURRENTS]; FREQUENCIES];
    let mut f = 0;
    while f < FREQUENCIES {
        let mut i = 0;
        while i < CURRENTS {
            r[f][i] = ((R_AT_45K[i] as u32 * R_FACTOR_Q15[f] + (1 << 14)) >> 15) as u16;
            l[f][i] = ((L_AT_45K[i] as u32 * L_FACTOR_Q15[f] + (1 << 14)) >> 15) as u16;
            i += 1;
        }
        f += 1;
    }
    RlLookup {
        version: 0,
        r,
        l,
        observed: [0; OBSERVED_BYTES],
    }
}

/// R and L that the estimator expects before it has seen a load: the prior's at the probe frequency, without current.
pub fn start_load() -> (MicroOhm, PicoHenry) {
    prior().interpolate(F_SW_MAX_HZ, 0)
}

#[cfg(test)]
mod tests {
    use super::super::{HENRY_PER_CODE, OHM_PER_CODE, grid};
    use super::*;

    #[test]
    fn cells_follow_the_stated_law() {
        let prior = prior();
        for f in 0..FREQUENCIES {
            for i in 0..CURRENTS {
                let (x, k) = (grid::frequency_hz(f) / 45e3, TURNS_RATIO);
                let a = grid::current_a(i) * k;
                let r = (3.0 + 4.0 / (1.0 + a / 9.0)) * x.sqrt() * k * k;
                let l = (20.5 + 18.0 / (1.0 + a / 10.0)) * 1e-6 * x.powf(-0.3) * k * k;
                assert!((f64::from(prior.r[f][i]) * OHM_PER_CODE / r - 1.0).abs() < 2e-4);
                assert!((f64::from(prior.l[f][i]) * HENRY_PER_CODE / l - 1.0).abs() < 2e-4);
            }
        }
    }
}
