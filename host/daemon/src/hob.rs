//! Ratings and controller limits of this build's hob.

use ihd_model::Hob;
use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ, RATED_POWER_W, REQUESTED_POWER_MAX_W};
use ihd_train::limits;

use crate::lease::LEASE_S;
use crate::tank;

/// Returns the ratings of this build's hob; those of an incompatible device may differ.
pub fn hob() -> Hob {
    Hob {
        rated_power_w: RATED_POWER_W,
        requested_power_max_w: REQUESTED_POWER_MAX_W,
        f_sw_min_hz: F_SW_MIN_HZ,
        f_sw_max_hz: F_SW_MAX_HZ,
        resonance_capacitance_f: tank::C_F,
        resonance_margin: limits::resonance_margin(),
        i_limit_a: limits::planned_current_a(),
        lease_s: LEASE_S as u32,
    }
}
