//! One step of Levenberg-Marquardt: the minimum of |e + J d|² + s |θ + d − c|² + µ |d|² over d, the problem
//! linearised around θ.

use nalgebra::{DMatrix, DVector};

use super::{Point, Prior};
use crate::normal_matrix::{Factor, gram, times, transposed_times};

impl Prior {
    /// θ − c.
    pub(super) fn distance(&self, theta: &[f64]) -> DVector<f64> {
        let differences = theta.iter().zip(&self.centre).map(|(x, c)| x - c);
        DVector::from_iterator(theta.len(), differences)
    }
}

/// The residuals around one point, `e + J d`, and the prior's pull.
pub(super) struct Linearised {
    /// J, a row a residual.
    jacobian: DMatrix<f64>,
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
    /// Around `at`, with J there.
    pub fn new(jacobian: DMatrix<f64>, at: &Point, prior: &Prior) -> Self {
        let pull = prior.distance(&at.theta) * prior.strength;
        let gradient = transposed_times(&jacobian, &at.value.residuals) + pull;
        let wide = jacobian.ncols() > jacobian.nrows();
        let product = if wide {
            gram(&jacobian.transpose())
        } else {
            gram(&jacobian)
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

    /// The model with a damping of `mu`, or nothing if rounding forbids it.
    pub fn damped(&self, mu: f64) -> Option<Damped<'_>> {
        let ridge = self.strength + mu;
        let factor = Factor::new(&self.product, ridge)?;
        let model = self;
        Some(Damped {
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
pub(super) struct Damped<'a> {
    model: &'a Linearised,
    factor: Factor,
    ridge: f64,
}

impl Damped<'_> {
    /// The step.
    pub fn step(&self) -> DVector<f64> {
        self.against(&self.model.gradient)
    }

    /// Second order of the step: with residuals that bend by `bend` along it, d²e/dx² for θ + x d, what has to be
    /// added to keep to the path of steepest descent (Transtrum and Sethna 2012, arXiv:1201.5885, eq. (9)).
    pub fn acceleration(&self, bend: &[f64]) -> DVector<f64> {
        self.against(&transposed_times(&self.model.jacobian, bend))
    }

    /// `J d`.
    pub fn slope(&self, step: &DVector<f64>) -> Vec<f64> {
        times(&self.model.jacobian, step)
    }

    /// −(JᵀJ + ridge I)⁻¹ g.
    fn against(&self, g: &DVector<f64>) -> DVector<f64> {
        if !self.model.wide {
            return -self.factor.solve(g);
        }
        // (JᵀJ + aI)⁻¹ = (I − Jᵀ(JJᵀ + aI)⁻¹J)/a: the smaller system of the two.
        let jacobian = &self.model.jacobian;
        let seen = self.factor.solve(&DVector::from(times(jacobian, g)));
        (transposed_times(jacobian, seen.as_slice()) - g) / self.ridge
    }
}
