//! Builds the RL lookup from identified windows.
//!
//! Every cell is the prior times a ratio. The ratios are one linear least-squares problem: each
//! observation says what the bilinear interpolation of its four cells should give, and weak ties
//! between neighbours spread what an observation cannot tell apart (a window has one frequency,
//! which lies between two rows). Cells that no observation touches keep the prior, bit for bit,
//! and are not marked as observed.

pub mod builder;
pub mod curve;

pub use builder::{Built, LookupBuilder};
pub use curve::LoadCurve;
