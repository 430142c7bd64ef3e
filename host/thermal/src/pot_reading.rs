//! Readings and events of a pot.

use serde::{Deserialize, Serialize};

/// Present state of a pot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PotReading {
    /// Time in seconds on the clock of the half-cycles.
    pub t_s: f64,
    /// Rise of the base's temperature since the pot was put on, in kelvin, within what its heat allows ([`HeatPrior`](crate::prior::HeatPrior)).
    pub rise_k: f64,
    /// Standard deviation of the rise in kelvin, including the unknown alloy and temperature at the start.
    pub sigma_k: f64,
    /// Rise in kelvin, and its standard deviation, by the heat alone, without R and L.
    pub prior_k: (f64, f64),
    /// Lift since the pot was put on, in mm.
    pub lift_mm: f64,
    /// Standard deviation of the lift in mm.
    pub lift_sigma_mm: f64,
    /// Set if bubbles carry most of the heat: the base is on its plateau.
    pub bubbles: bool,
    /// Set if all of the contents boil.
    pub boils: bool,
    /// Set if the pot is too hot to contain water.
    pub overheats: bool,
}

/// Event of a pot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "kebab-case")]
pub enum PotEvent {
    /// A pot was put on; ΔT begins at 0.
    Placed {
        /// Diameter of its base in metre, as far as R and L determine it.
        diameter_m: f64,
        /// Set if its metal is closer to cast iron than to ferritic steel.
        is_cast_iron: bool,
        /// Set if the class of metal is certain; else R and L lie between both, or were measured at too few operating points.
        is_sure: bool,
    },
    /// The pot was moved: R and L changed faster than heat can change them.
    Moved {
        /// Change of lift in mm.
        lift_mm: f64,
        /// Set if lift alone explains the change; else the pot was shifted, too.
        straight: bool,
    },
    /// The base reached its plateau: bubbles carry the heat.
    Bubbles,
    /// All of the contents boil.
    Boils {
        /// Beginning of boiling in seconds on the clock of the half-cycles.
        since_s: f64,
    },
    /// ΔT is higher than with water in the pot.
    Overheats {
        /// ΔT in kelvin, as the reading has it.
        rise_k: f64,
        /// Set beyond the turn, where R and L fall with heat: toward the Curie point.
        toward_curie: bool,
    },
}
