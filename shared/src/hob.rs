//! Ratings of the hob that the controller regulates and the simulator models.

/// Series resonance capacitor C_r, in nanofarad (paper, section IV).
pub const RESONANCE_CAPACITANCE_NF: u32 = 1080;

/// Lowest switching frequency the controller may ask for, in hertz. Below it the widest lookup
/// column ends and the tank of the smallest inductance is already near resonance.
pub const F_SW_MIN_HZ: u32 = 34_000;

/// Highest switching frequency, in hertz: the probe frequency, at which any load is harmless.
pub const F_SW_MAX_HZ: u32 = 80_000;

/// Rated mean power over a mains half-cycle, in watt.
pub const RATED_POWER_W: u16 = 2500;

/// Peak of the rectified mains of a 230 V supply, in volt (paper, section IV).
pub const BUS_PEAK_V: f64 = 230.0 * core::f64::consts::SQRT_2;

/// Duration of the inverter's voltage edges, in nanoseconds (paper, section IV).
pub const EDGE_NS: u32 = 200;

/// Capacitance of the half-bridge's node (both switches and their snubbers), in nanofarad. It follows
/// from the edge: the coil's current at turn-off, some 24 A, moves the bus's 325 V in [`EDGE_NS`].
pub const NODE_CAPACITANCE_NF: u32 = 15;
