//! Quantities as they travel and are stored: integers with the unit in the type.

use serde::{Deserialize, Serialize};

/// Resistance in micro-ohm; ±2147 ohm.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    bytemuck::Pod,
    bytemuck::Zeroable,
)]
#[repr(transparent)]
pub struct MicroOhm(pub i32);

/// Inductance in picohenry; ±2147 µH.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    bytemuck::Pod,
    bytemuck::Zeroable,
)]
#[repr(transparent)]
pub struct PicoHenry(pub i32);

impl MicroOhm {
    /// The value in ohm.
    pub fn ohm(self) -> f64 {
        f64::from(self.0) * 1e-6
    }
}

impl PicoHenry {
    /// The value in henry.
    pub fn henry(self) -> f64 {
        f64::from(self.0) * 1e-12
    }
}
