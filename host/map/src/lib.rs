//! Map of one pot: R and L with their deviations at every frequency and current, from a few operating points.
//!
//! ```text
//! window ─► R(I), L(I) ─► CurrentCurve ─► PotMap ─► physics fitted + misfit ─► Cells of a lookup, each R, L ± σ and age
//!                         curve.rs pot_map.rs pot_fit.rs, posterior.rs
//! ```
//!
//! The physics ([`PotModel`]) is seven numbers of coil and pot. Its error (the misfit) is a smooth normal process over
//! frequency and current, whose deviation the evidence chooses. Where the physics fits, unseen cells follow it. Where it
//! does not, they follow the measured curves, and their deviations are larger.

pub mod curve;
mod drift;
mod fit;
pub mod gap_table;
mod heat;
mod hypotheses;
pub mod library;
mod misfit;
mod parameters;
mod posterior;
mod pot_export;
mod pot_fit;
pub mod pot_map;
pub mod pot_model;
mod sector;
mod surface_table;

pub use curve::{CurrentCurve, Mean, MeasuredPoint, window_floor};
pub use library::{Library, LibraryError, PotEntry, Provenance};
pub use misfit::current_knots;
pub use posterior::RlPrediction;
pub use pot_map::{Cells, CurveMatch, MapCell, PotMap, PotMapState};
pub use pot_model::PotModel;
