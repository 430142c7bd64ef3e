//! Electromagnetic field model of coil, ferrite, shield and load (paper, section IV).
//!
//! A load that saturates has three parts, each a linear or a one-dimensional problem:
//!
//! 1. [`gap`]: the magnetostatic field between shield and load, axisymmetric finite volumes. It is linear, so it is solved once
//!    and condensed to a few numbers per ring of the load's surface: bottom, side, and top or wall ([`contour`]).
//! 2. [`diffusion`]: the field inside the load. The skin depth (0.03 mm at 45 kHz) is far
//!    below any radial length, so under each ring the field diffuses along depth only; the
//!    material is nonlinear ([`material`]).
//! 3. The coupling: ring surfaces exchange H (tangential field, A/m) and A (flux per unit
//!    circumference, Wb/m) with the gap, the coil exchanges current and flux linkage with the
//!    circuit. Everything is implicit in the same time step.
//!
//! Under a linear metal the skin depth may be as large as the base is thick, and the field is not one-dimensional at its edge.
//! The whole problem is linear then: [`modes`] solves it with metal and shield in the grid, and keeps eight relaxations.
//!
//! [`harmonic`] is the frequency-domain counterpart, [`layered`] an independent solution of the
//! linear problem for infinite plates.
//!
//! Transcendental functions come from `libm`, sums run in a fixed order on one thread: results
//! are the same to the last digit on every machine.

pub mod approximation;
mod banded;
pub mod contour;
pub mod depth;
pub mod diffusion;
pub mod error;
pub mod gap;
pub mod geometry;
pub mod grid;
pub mod harmonic;
pub mod layered;
pub mod load;
pub mod material;
pub mod model;
pub mod modes;
pub mod profile;
mod reluctance;
pub mod spd;
pub mod surface;
pub mod tank;

pub use diffusion::FluxLine;
pub use error::FieldError;
pub use geometry::Geometry;
pub use load::FieldLoad;
pub use material::Material;
pub use model::FieldModel;
