//! Derivatives of the residuals by the parameters, as a matrix or as its factors.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use crate::network_jacobian::NetworkJacobian;
use crate::normal_matrix;

/// Jacobian J, a row per residual and a column per parameter.
pub(crate) enum Derivatives {
    /// Any matrix.
    Matrix(DMatrix<f64>),
    /// Factors of the RL-MLP's.
    OfNetwork(NetworkJacobian),
}

impl Derivatives {
    /// Numbers of residuals and of parameters.
    pub fn shape(&self) -> (usize, usize) {
        match self {
            Self::Matrix(matrix) => matrix.shape(),
            Self::OfNetwork(network) => (network.rows, network.columns()),
        }
    }

    /// J.
    pub fn dense(&self) -> Cow<'_, DMatrix<f64>> {
        match self {
            Self::Matrix(matrix) => Cow::Borrowed(matrix),
            Self::OfNetwork(network) => Cow::Owned(network.dense()),
        }
    }

    /// JᵀJ.
    pub fn gram(&self) -> DMatrix<f64> {
        match self {
            Self::Matrix(matrix) => normal_matrix::gram(matrix),
            Self::OfNetwork(network) => network.gram(),
        }
    }

    /// Jᵀx.
    pub fn transposed_times(&self, x: &[f64]) -> DVector<f64> {
        match self {
            Self::Matrix(matrix) => normal_matrix::transposed_times(matrix, x),
            Self::OfNetwork(network) => network.transposed_times(x),
        }
    }

    /// Jx.
    pub fn times(&self, x: &DVector<f64>) -> Vec<f64> {
        match self {
            Self::Matrix(matrix) => normal_matrix::times(matrix, x),
            Self::OfNetwork(network) => network.times(x),
        }
    }
}
