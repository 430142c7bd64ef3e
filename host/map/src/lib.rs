//! What is known of a pot: a few operating points, and R and L with their deviations everywhere else.
//!
//! ```text
//! window ─► R(I), L(I) ─► Curve ─► PotMap ─► physics fitted + misfit ─► Cells of a lookup, each R, L ± σ and age
//!                         curve.rs pot_map.rs fit.rs  knowledge.rs
//! ```
//!
//! The physics ([`PotModel`]) is seven numbers of coil and pot. What it leaves is a smooth normal process over frequency
//! and current whose deviation the evidence chooses: where the physics fits, unseen cells follow it; where it does
//! not, they follow what was taught, and their deviations say so.

pub mod curve;
mod ended;
mod fit;
pub mod gap_table;
mod hypotheses;
mod knowledge;
pub mod library;
mod misfit;
mod parameters;
pub mod pot_map;
pub mod pot_model;
mod surface_table;
mod telling;

pub use curve::{Curve, Mean, MeasuredPoint};
pub use knowledge::Predicted;
pub use library::{Library, LibraryError, PotEntry, Provenance};
pub use misfit::current_knots;
pub use pot_map::{Cell, Cells, Kept, PotMap, Seen};
pub use pot_model::PotModel;
