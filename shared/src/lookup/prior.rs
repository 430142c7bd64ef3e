//! The prior: a 21 cm ferromagnetic pot, the load that the firmware assumes before a lookup is pushed.
//!
//! R(I) = 3.0 + 4.0 / (1 + I / 9 A) ohm and L(I) = 20.5 + 18 / (1 + I / 10 A) µH at 45 kHz, which
//! pass through 6.6 → 3.7 ohm and 37 → 24 µH from 1 to 40 A (field model of design.md section 7);
//! with frequency R ∝ f^½ (skin depth) and L ∝ f^−0.3 (part of it is the gap's, which stays).

use super::grid::{CURRENTS, FREQUENCIES};
use super::{OBSERVED_BYTES, RlLookup};

/// R at 45 kHz by current knot, in lookup codes; tests compare with the formula.
const R_AT_45K: [u16; CURRENTS] = [
    28672, 27080, 25543, 24080, 22707, 21436, 20273, 19221, 18278, 17442, 16706, 16062, 15503,
    15020, 14605, 14249, 13945,
];

/// L at 45 kHz by current knot, in lookup codes; tests compare with the formula.
const L_AT_45K: [u16; CURRENTS] = [
    39424, 37796, 36194, 34640, 33156, 31759, 30460, 29269, 28188, 27217, 26354, 25592, 24925,
    24345, 23843, 23411, 23040,
];

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

#[cfg(test)]
mod tests {
    use super::super::{HENRY_PER_CODE, OHM_PER_CODE, grid};
    use super::*;

    #[test]
    fn cells_follow_the_stated_law() {
        let prior = prior();
        for f in 0..FREQUENCIES {
            for i in 0..CURRENTS {
                let (x, a) = (grid::frequency_hz(f) / 45e3, grid::current_a(i));
                let r = (3.0 + 4.0 / (1.0 + a / 9.0)) * x.sqrt();
                let l = (20.5 + 18.0 / (1.0 + a / 10.0)) * 1e-6 * x.powf(-0.3);
                assert!((f64::from(prior.r[f][i]) * OHM_PER_CODE / r - 1.0).abs() < 2e-4);
                assert!((f64::from(prior.l[f][i]) * HENRY_PER_CODE / l - 1.0).abs() < 2e-4);
            }
        }
    }
}
