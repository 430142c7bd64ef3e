//! Temperature rise of a pot since it was put on, and detection of boiling, overheating and movement.
//!
//! ```text
//! half-cycles (f, I, R, L, P) ─► batches ─► placement: metal and size of the pot
//!                                   └─────► filter: ΔT, lift ─► contents: boiling
//! ```
//!
//! Heat acts on R and L through one number, the metal's resistivity times its saturation. Lift changes R and L in a different
//! ratio, so that both can be found from two measured values. The temperature is never absolute, and never an input of protection.

mod alloy;
pub mod batch;
pub mod contents;
pub mod filter;
mod least_squares;
pub mod metal;
pub mod placement;
mod pot_reading;
pub mod prior;
pub mod reversal;
pub mod thermometer;
mod tracked_pot;
pub mod turnover;

pub use alloy::{ImpossibleAlloys, KnownAlloys};
pub use batch::ThermalHalfCycle;
pub use metal::MetalLaw;
pub use pot_reading::{PotEvent, PotReading};
pub use thermometer::{GAP_S, Thermometer};
