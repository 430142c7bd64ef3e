//! Cubic B-splines in slow time, and the banded normal equations of least squares with them.
//!
//! What moves with the mains envelope (phasors, R, L) is written as a spline with a few tens of
//! knots a half-cycle; a basis function overlaps only three neighbours on either side, so that the
//! normal equations are banded and cost next to nothing.

mod banded;
mod basis;
pub mod harmonic;
pub mod residual;
mod single_samples;

pub use banded::{Banded, Singular};
pub use basis::{CubicSpline, Local, quiet_interval_s};
