//! Cubic B-splines in slow time, and least squares with their banded normal equations.
//!
//! Quantities that follow the mains envelope (phasors, R, L) are splines with a few tens of knots per half-cycle. A basis
//! function overlaps only three neighbours on either side, so that the normal equations are banded and cheap.
//!
//! - [`CubicSpline`]: the basis; [`Banded`]: the normal equations and their solver.
//! - [`harmonic`]: fit of harmonic phasors to samples of voltage and current.
//! - [`residual`]: error of such a fit beyond white noise.

mod banded;
mod basis;
pub mod harmonic;
pub mod residual;
mod single_samples;

pub use banded::{Banded, SingularMatrix};
pub use basis::{BasisValues, CubicSpline, quiet_interval_s};
