//! Equivalent load of coil and pot.

use serde::{Deserialize, Serialize};

/// Equivalent resistance and inductance of coil and pot in series, at one instant or as a mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
}
