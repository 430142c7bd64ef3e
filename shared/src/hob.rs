//! Ratings of the hob that the controller regulates and the simulator models; [`crate::board`] has those of the board's file.

pub use crate::board::{
    F_SW_MAX_HZ, F_SW_MIN_HZ, LINK_CAPACITANCE_NF, NODE_CAPACITANCE_NF, RATED_POWER_W,
    RESONANCE_CAPACITANCE_NF,
};

/// Largest power that may be requested, in watt: more is an error of whoever asks. A request between the rating and this
/// is granted with the rating.
pub const REQUESTED_POWER_MAX_W: u16 = 10_000;

const _: () = assert!(RATED_POWER_W <= REQUESTED_POWER_MAX_W);

/// Capacitance that the bridge sees in series with the coil, in picofarad. While the upper switch is on, the coil's current flows
/// through C2 as well, and the rectifier recharges it evenly: to the fundamental that is C2 / (1/2 − 2/π²) in series with C_r.
pub const TANK_CAPACITANCE_PF: u32 = {
    let (c_r, c_2) = (RESONANCE_CAPACITANCE_NF as f64, LINK_CAPACITANCE_NF as f64);
    (c_r * 1e3 * c_2 / (c_2 + c_r * LINK_SHARE)) as u32
};

/// Share of the link's ripple in the bridge's fundamental, over that of the coil's current in the link: a lagging current that flows from
/// the bus for half of the period leaves it at a half-sine above its mean.
pub const LINK_SHARE: f64 = 0.5 - 2.0 / (core::f64::consts::PI * core::f64::consts::PI);

/// Turns of the coil over the 23 of the paper's coil, for which [`crate::lookup::prior`] and the simulation's formulas are given. With
/// other turns in the same place R and L are its square times as large, at currents that are so many times smaller.
pub const TURNS_RATIO: f64 = crate::board::COIL_TURNS as f64 / 23.0;

/// Resistance of the winding and its leads, in ohm.
pub const WINDING_R_OHM: f64 = crate::board::WINDING_MOHM as f64 / 1e3;

/// Peak of the rectified mains of nominal voltage, in volt; on the reference board that of the paper, section IV.
pub const BUS_PEAK_V: f64 = crate::board::MAINS_VOLTAGE_V as f64 * core::f64::consts::SQRT_2;

/// Duration of the inverter's voltage edges, in nanoseconds (paper, section IV).
pub const EDGE_NS: u32 = 200;
