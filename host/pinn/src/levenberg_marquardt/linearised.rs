//! One step of Levenberg-Marquardt: the minimum of |e + J d|² + s |θ + d − c|² + µ |d|² over d, the problem
//! linearised around θ.

use nalgebra::{DMatrix, DVector};

use super::{Point, Prior};

impl Prior {
    /// θ − c.
    pub(super) fn distance(&self, theta: &[f64]) -> DVector<f64> {
        let differences = theta.iter().zip(&self.centre).map(|(x, c)| x - c);
        DVector::from_iterator(theta.len(), differences)
    }
}

/// The residuals around one point, `e + J d`, and the prior's pull.
pub(super) struct Linearised {
    /// Jᵀ, one column per residual.
    transposed: DMatrix<f64>,
    /// Half the gradient of F: `Jᵀe + s (θ − c)`.
    gradient: DVector<f64>,
    /// JᵀJ, or JJᵀ where there are more parameters than residuals.
    product: DMatrix<f64>,
    wide: bool,
    strength: f64,
    /// Largest diagonal entry of the product: the scale of the damping.
    pub scale: f64,
}

impl Linearised {
    /// `rows` is J, row by row.
    pub fn new(rows: Vec<f64>, at: &Point, prior: &Prior) -> Self {
        let pull = prior.distance(&at.theta) * prior.strength;
        let (parameters, residuals) = (pull.len(), at.value.residuals.len());
        let transposed = DMatrix::from_vec(parameters, residuals, rows);
        let gradient = &transposed * DVector::from_column_slice(&at.value.residuals) + pull;
        let wide = parameters > residuals;
        let across = transposed.transpose();
        let product = if wide {
            &across * &transposed
        } else {
            &transposed * &across
        };
        let scale = product.diagonal().max().max(f64::MIN_POSITIVE);
        Self {
            transposed,
            gradient,
            product,
            wide,
            strength: prior.strength,
            scale,
        }
    }

    /// The step for a damping of `mu`, or nothing if rounding forbids it.
    pub fn step(&self, mu: f64) -> Option<DVector<f64>> {
        let ridge = self.strength + mu;
        let mut damped = self.product.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += ridge;
        }
        let factor = damped.cholesky()?;
        if !self.wide {
            return Some(-factor.solve(&self.gradient));
        }
        // (JᵀJ + aI)⁻¹ = (I − Jᵀ(JJᵀ + aI)⁻¹J)/a: the smaller system of the two.
        let seen = factor.solve(&self.transposed.tr_mul(&self.gradient));
        Some((&self.transposed * seen - &self.gradient) / ridge)
    }

    /// Descent of the linearised F along `step`: for this step `dᵀ(µd − gradient)`.
    pub fn predicted_descent(&self, step: &DVector<f64>, mu: f64) -> f64 {
        step.dot(&(step * mu - &self.gradient))
    }
}
