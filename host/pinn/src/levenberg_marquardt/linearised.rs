//! One step of Levenberg-Marquardt: the minimum of |e + J d|² + s |θ + d − c|² + µ |d|² over d, the problem
//! linearised around θ.

use nalgebra::{DMatrix, DVector};

use super::problem::Prior;
use crate::derivatives::Derivatives;
use crate::normal_matrix::{Factor, gram};

/// Linearised residuals around one point, `e + J d`, with the prior.
pub(super) struct LinearModel {
    /// J, one row per residual.
    jacobian: Derivatives,
    /// Half the gradient of F: `Jᵀe + s (θ − c)`.
    gradient: DVector<f64>,
    /// JᵀJ, or JJᵀ where there are more parameters than residuals.
    product: DMatrix<f64>,
    wide: bool,
    strength: f64,
    /// Largest diagonal entry of the product: the scale of the damping.
    pub scale: f64,
}

impl LinearModel {
    /// Linearises around `theta`, where the residuals and their Jacobian are known.
    pub fn new(jacobian: Derivatives, theta: &[f64], residuals: &[f64], prior: &Prior) -> Self {
        let pull = prior.distance(theta) * prior.strength;
        let gradient = jacobian.transposed_times(residuals) + pull;
        let (residuals, parameters) = jacobian.shape();
        let wide = parameters > residuals;
        let product = if wide {
            gram(&jacobian.dense().transpose())
        } else {
            jacobian.gram()
        };
        let scale = product.diagonal().max().max(f64::MIN_POSITIVE);
        Self {
            jacobian,
            gradient,
            product,
            wide,
            strength: prior.strength,
            scale,
        }
    }

    /// Adds a damping of `mu`; `None` if rounding makes the matrix indefinite.
    pub fn damped(&self, mu: f64) -> Option<DampedModel<'_>> {
        let ridge = self.strength + mu;
        let factor = Factor::new(&self.product, ridge)?;
        let model = self;
        Some(DampedModel {
            model,
            factor,
            ridge,
        })
    }

    /// Descent of the linearised F along `step`: for this step `dᵀ(µd − gradient)`.
    pub fn predicted_descent(&self, step: &DVector<f64>, mu: f64) -> f64 {
        step.dot(&(step * mu - &self.gradient))
    }
}

/// JᵀJ + (s + µ) I, factorised.
pub(super) struct DampedModel<'a> {
    model: &'a LinearModel,
    factor: Factor,
    ridge: f64,
}

impl DampedModel<'_> {
    /// Step of the damped model.
    pub fn step(&self) -> DVector<f64> {
        self.against(&self.model.gradient)
    }

    /// Second order of the step: for residuals with the second derivative `bend` along it, d²e/dx² for θ + x d, the change
    /// that keeps to the path of steepest descent (Transtrum and Sethna 2012, arXiv:1201.5885, eq. (9)).
    pub fn acceleration(&self, bend: &[f64]) -> DVector<f64> {
        self.against(&self.model.jacobian.transposed_times(bend))
    }

    /// `J d`.
    pub fn slope(&self, step: &DVector<f64>) -> Vec<f64> {
        self.model.jacobian.times(step)
    }

    /// −(JᵀJ + ridge I)⁻¹ g.
    fn against(&self, g: &DVector<f64>) -> DVector<f64> {
        if !self.model.wide {
            return -self.factor.solve(g);
        }
        // (JᵀJ + aI)⁻¹ = (I − Jᵀ(JJᵀ + aI)⁻¹J)/a: the smaller system of the two.
        let jacobian = &self.model.jacobian;
        let seen = self.factor.solve(&DVector::from(jacobian.times(g)));
        (jacobian.transposed_times(seen.as_slice()) - g) / self.ridge
    }
}
