//! Droop of the current transformer (docs/board.md): the current leads by 1/(ωτ), so that the load appears with L/τ more resistance.

use ihd_shared::sampling::CURRENT_TRANSFORMER_TAU_US;
use ihd_shared::units::{MicroOhm, PicoHenry};

use crate::fixed::{narrow_fitting, wide};

/// 2^32 over τ in microseconds: picohenry by microsecond are micro-ohm.
const PER_TAU_Q32: i32 = ((1 << 32) / CURRENT_TRANSFORMER_TAU_US as i64) as i32;

/// Resistance by which a load of this inductance appears larger than it is.
#[inline(always)]
pub fn apparent_r(l: PicoHenry) -> MicroOhm {
    MicroOhm(narrow_fitting(wide(l.0, PER_TAU_Q32), 32))
}

/// Power in the load, of the power that the sampled current shows.
pub fn true_power_mw(shown_mw: u64, r: MicroOhm, l: PicoHenry) -> u64 {
    let [r, excess] = [r, apparent_r(l)].map(|r| u64::from(r.0.max(0).unsigned_abs()));
    shown_mw - shown_mw * excess / (r + excess).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 80 µH over 11.236 ms are 7.12 mΩ: of 3 Ω and 1 kW, 2.37 W.
    #[test]
    fn a_load_appears_with_l_over_tau_more_resistance() {
        let (r, l) = (MicroOhm(3_000_000), PicoHenry(80_000_000));
        assert!((apparent_r(l).0 - 7_120).abs() <= 1);
        assert!(true_power_mw(1_000_000, r, l).abs_diff(997_632) <= 1);
        assert_eq!(true_power_mw(1_000, MicroOhm(0), PicoHenry(0)), 1_000);
    }
}
