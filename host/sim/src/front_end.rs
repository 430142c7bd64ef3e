//! Front end: full scales and poles at the converters' pins, computed from the schematic's parts.
//!
//! The firmware reads by rounded ones (`[sensors]` of the board's file); the differences are its errors on a board (docs/board.md,
//! "Scales").

use std::f64::consts::TAU;

use ihd_shared::board;
use ihd_shared::sampling::{CODE_HALF_RANGE, I_FULL_SCALE_A, V_FULL_SCALE_V};

/// Supply of the analogue parts, in volt.
pub const NOMINAL_SUPPLY_V: f64 = 3.3;

/// Mid-scale of the signals that have a sign, in volt.
pub const MID_SCALE_V: f64 = NOMINAL_SUPPLY_V / 2.0;

/// Resistance of each chain of the coil voltage's divider to [`MID_SCALE_V`], in ohm: the amplifier holds the lower ends together.
pub const COIL_CHAIN_OHM: f64 =
    board::COIL_DIVIDER_OHM as f64 + board::COIL_DIVIDER_BOTTOM_OHM as f64;

/// Resistance of the bus divider, in ohm.
pub const BUS_CHAIN_OHM: f64 = board::BUS_DIVIDER_OHM as f64 + board::BUS_DIVIDER_BOTTOM_OHM as f64;

/// Resistance of each chain of the mains voltage's divider, in ohm.
pub const MAINS_CHAIN_OHM: f64 =
    board::MAINS_DIVIDER_OHM as f64 + board::MAINS_DIVIDER_BOTTOM_OHM as f64;

/// Half the input range of the coil voltage, in volt.
pub const COIL_VOLTAGE_FULL_SCALE_V: f64 =
    MID_SCALE_V * board::COIL_DIVIDER_OHM as f64 / board::COIL_DIVIDER_BOTTOM_OHM as f64;

/// Half the input range of the coil current, in ampere.
pub const COIL_CURRENT_FULL_SCALE_A: f64 =
    MID_SCALE_V / (board::BURDEN_MOHM as f64 * 1e-3) * board::CURRENT_TRANSFORMER_TURNS as f64;

/// Bus voltage at the end of the converter's range, in volt.
pub const BUS_FULL_SCALE_V: f64 =
    NOMINAL_SUPPLY_V * BUS_CHAIN_OHM / board::BUS_DIVIDER_BOTTOM_OHM as f64;

/// Half the input range of the mains voltage, in volt.
pub const MAINS_FULL_SCALE_V: f64 =
    MID_SCALE_V * board::MAINS_DIVIDER_OHM as f64 / board::MAINS_DIVIDER_BOTTOM_OHM as f64;

/// Coil voltage of one code, in volt.
pub const VOLT_PER_CODE: f64 = COIL_VOLTAGE_FULL_SCALE_V / CODE_HALF_RANGE as f64;

/// Coil current of one code, in ampere.
pub const AMPERE_PER_CODE: f64 = COIL_CURRENT_FULL_SCALE_A / CODE_HALF_RANGE as f64;

/// Impedance that the firmware reads, over the coil's: the error of its rounded scales, which is in no standard deviation.
pub const IMPEDANCE_GAIN: f64 =
    (V_FULL_SCALE_V / COIL_VOLTAGE_FULL_SCALE_V) / (I_FULL_SCALE_A / COIL_CURRENT_FULL_SCALE_A);

/// Anti-alias pole of coil voltage and current, in hertz.
pub const ANTI_ALIAS_HZ: f64 = pole_hz(board::PIN_OHM as f64, board::FAST_PIN_PF);

/// Pole at the pins of bus and mains, in hertz.
pub const SLOW_PIN_POLE_HZ: f64 = pole_hz(board::PIN_OHM as f64, board::SLOW_PIN_PF);

/// Pole of the bus divider, in hertz.
pub const BUS_POLE_HZ: f64 = pole_hz(
    board::BUS_DIVIDER_OHM as f64 * board::BUS_DIVIDER_BOTTOM_OHM as f64 / BUS_CHAIN_OHM,
    board::BUS_DIVIDER_PF,
);

/// Pole of the mains amplifier, in hertz.
pub const MAINS_POLE_HZ: f64 = pole_hz(
    board::MAINS_DIVIDER_BOTTOM_OHM as f64,
    board::MAINS_AMPLIFIER_PF,
);

const fn pole_hz(ohm: f64, pf: u32) -> f64 {
    1.0 / (TAU * ohm * pf as f64 * 1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arithmetic of docs/board.md, "Scales", by hand, with the errors that it states of the firmware's scales.
    #[test]
    fn the_schematics_scales_and_poles_are_those_of_its_parts() {
        let scales = [
            (COIL_VOLTAGE_FULL_SCALE_V, 640.4, 0.06),
            (COIL_CURRENT_FULL_SCALE_A, 80.10, 0.06),
            (BUS_FULL_SCALE_V, 498.0, 0.06),
            (MAINS_FULL_SCALE_V, 399.8, 0.06),
            (ANTI_ALIAS_HZ * 1e-3, 503.7, 0.06),
            (BUS_POLE_HZ * 1e-3, 11.77, 0.006),
            (MAINS_POLE_HZ * 1e-3, 18.89, 0.006),
            (SLOW_PIN_POLE_HZ * 1e-3, 50.37, 0.006),
        ];
        for (got, expected, tolerance) in scales {
            assert!((got - expected).abs() < tolerance, "{got} {expected}");
        }
        let percent = |true_scale: f64, nominal: f64| 100.0 * (true_scale / nominal - 1.0);
        let errors = [
            (percent(COIL_VOLTAGE_FULL_SCALE_V, V_FULL_SCALE_V), 0.06),
            (percent(COIL_CURRENT_FULL_SCALE_A, I_FULL_SCALE_A), 0.12),
        ];
        for (got, expected) in errors {
            assert!((got - expected).abs() < 0.006, "{got} {expected}");
        }
    }
}
