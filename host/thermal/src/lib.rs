//! How much warmer a pot is than when it was put on, whether it boils, overheats or was moved.
//!
//! ```text
//! half-cycles (f, I, R, L, P) ─► batches ─► placement: which pot is it
//!                                   └─────► filter: ΔT, lift ─► contents: does it boil
//! ```
//!
//! Heat acts on R and L through one number, the metal's resistivity times its saturation; lift moves R and L apart: two
//! measured numbers, two unknowns. Never an absolute temperature, and never an input of protection.

pub mod batch;
pub mod contents;
pub mod filter;
mod gauss_newton;
pub mod metal;
pub mod placement;
pub mod thermometer;
pub mod turning;

pub use batch::HalfCycle;
pub use metal::MetalLaw;
pub use thermometer::{PotEvent, Reading, Thermometer};
