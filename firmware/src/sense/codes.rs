//! Thresholds of the sampling path in ADC codes, from the limits in ampere and volt.

use ihd_shared::sampling::{AMPERE_PER_CODE, CODE_HALF_RANGE, V_FULL_SCALE_V};

use crate::limits::{SOFT_COIL_VOLTAGE_DV, SOFT_CURRENT_MA, TRIP_CURRENT_MA};

/// Coil current that trips.
pub const TRIP_CODE: u16 = (TRIP_CURRENT_MA as f64 * 1e-3 / AMPERE_PER_CODE) as u16;

/// Coil current of the soft limit.
pub const SOFT_CURRENT_CODE: u16 = (SOFT_CURRENT_MA as f64 * 1e-3 / AMPERE_PER_CODE) as u16;

/// Coil voltage of the soft limit.
pub const SOFT_VOLTAGE_CODE: u16 =
    (SOFT_COIL_VOLTAGE_DV as f64 * 0.1 * CODE_HALF_RANGE as f64 / V_FULL_SCALE_V) as u16;

#[cfg(test)]
mod tests {
    use super::*;

    /// Each code is the last one that does not exceed its limit, and the soft limits lie below the trip.
    #[test]
    fn codes_are_the_limits_to_within_one_code() {
        let volt_per_code = V_FULL_SCALE_V / CODE_HALF_RANGE as f64;
        for (code, per_code, limit) in [
            (TRIP_CODE, AMPERE_PER_CODE, TRIP_CURRENT_MA as f64 * 1e-3),
            (
                SOFT_CURRENT_CODE,
                AMPERE_PER_CODE,
                SOFT_CURRENT_MA as f64 * 1e-3,
            ),
            (
                SOFT_VOLTAGE_CODE,
                volt_per_code,
                SOFT_COIL_VOLTAGE_DV as f64 * 0.1,
            ),
        ] {
            let below = limit - f64::from(code) * per_code;
            assert!((0.0..per_code).contains(&below), "{code}: {below}");
            assert!(f64::from(code) < CODE_HALF_RANGE as f64, "{code}");
        }
        const { assert!(SOFT_CURRENT_CODE < TRIP_CODE) };
    }
}
