//! Equivalent load of coil and pot.

use serde::{Deserialize, Serialize};

/// Harmonic orders of the switching frequency that are measured; a half-bridge has no even ones.
pub const ORDERS: [u32; 4] = [1, 3, 5, 7];

/// Equivalent resistance and inductance of coil and pot in series, at one instant or as a mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
}
