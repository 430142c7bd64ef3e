//! Interface of the kernels that compute eq. (7) and its gradient: the fused one, or burn on one of its backends.

use std::ops::Range;

use super::collocation::{Collocation, Impedances};
use super::shape::Shape;
use crate::PinnError;

/// Weights of eq. (7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weights {
    /// Weight of the physics term.
    pub w_f: f32,
    /// Weight of each data term.
    pub w_i: f32,
}

/// Terms of the loss as means over the points of a batch: eqs. (4), (5), (6).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Terms {
    pub l_f: f64,
    pub l_i1: f64,
    pub l_i2: f64,
}

impl Terms {
    /// Total loss, eq. (7).
    pub fn total(&self, weights: Weights) -> f64 {
        f64::from(weights.w_f) * self.l_f + f64::from(weights.w_i) * (self.l_i1 + self.l_i2)
    }
}

/// Inputs that stay the same during a training.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub shape: &'a Shape,
    pub points: &'a Collocation,
    pub impedances: Impedances,
}

/// Kernel that computes the loss.
pub(crate) trait Kernel {
    /// Terms of the loss over the points of `batch`, and the gradient of eq. (7) by `theta`,
    /// written to `gradient`.
    fn loss(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
        batch: Range<usize>,
        weights: Weights,
        gradient: &mut [f32],
    ) -> Result<Terms, PinnError>;

    /// `v_hat` and `i_hat` at all points, normalised.
    fn signals(
        &mut self,
        problem: &Problem<'_>,
        theta: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), PinnError>;
}
