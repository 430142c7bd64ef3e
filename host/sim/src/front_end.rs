//! Front end: what the board's file says of it, in the units that the simulation computes with (docs/board.md, "Scales").

use ihd_shared::board;

/// Supply of the analogue parts, in volt.
pub const NOMINAL_SUPPLY_V: f64 = board::NOMINAL_SUPPLY_MV as f64 / 1e3;

/// Code of the chip's reference voltage at a supply of 3.0 V, as its maker found it: 1.212 V (DS12288: 1.182 to 1.232 V).
pub const REFERENCE_CALIBRATION: u16 = 1_655;

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

/// Bus voltage at the end of the converter's range, in volt.
pub const BUS_FULL_SCALE_V: f64 = board::BUS_FULL_SCALE_DV as f64 / 10.0;
