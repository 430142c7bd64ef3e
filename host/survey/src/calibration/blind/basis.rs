//! Polynomials that are orthonormal on evenly spaced samples, with their integrals and derivatives.
//!
//! Between two edges the coil's current is smooth: a polynomial of degree 8 follows half a period to 1e-5. Its integral and
//! its derivatives are then exact, at seven samples as at a thousand. White noise on the samples is white noise of the
//! same deviation on the coefficients.

use std::collections::BTreeMap;
use std::rc::Rc;

use ihd_signal::vectorised::{dot, vectorised};
use nalgebra::{DMatrix, DVector};

/// Highest degree.
const DEGREE: usize = 8;

/// Fewest samples, so that they are more than the polynomials' own freedom.
pub(super) const MIN_SAMPLES: usize = 6;

/// Orthonormal polynomials on a number of samples.
#[derive(Debug)]
pub(super) struct Basis {
    /// Values; one row per sample, one column per polynomial.
    values: DMatrix<f64>,
    /// Coefficients of the integral, for a time unit of half the samples' extent.
    integral: DMatrix<f64>,
    /// Coefficients of the derivative, for a time unit of half the samples' extent.
    derivative: DMatrix<f64>,
    /// Coefficients of the straight line from −1 to 1.
    pub line: DVector<f64>,
}

impl Basis {
    /// Creates the basis for a number of samples, at least [`MIN_SAMPLES`].
    fn new(samples: usize) -> Self {
        let m = DEGREE.min(samples - 2) + 1;
        let at = |k: usize| 2.0 * k as f64 / (samples - 1) as f64 - 1.0;
        // Legendre's polynomials, one more than needed, and their derivatives.
        let mut p = DMatrix::from_fn(samples, m + 1, |_, l| f64::from(u8::from(l == 0)));
        let mut d = DMatrix::zeros(samples, m + 1);
        for k in 0..samples {
            let x = at(k);
            (p[(k, 1)], d[(k, 1)]) = (x, 1.0);
            for l in 1..m {
                let n = l as f64;
                p[(k, l + 1)] = ((2.0 * n + 1.0) * x * p[(k, l)] - n * p[(k, l - 1)]) / (n + 1.0);
                d[(k, l + 1)] = (2.0 * n + 1.0) * p[(k, l)] + d[(k, l - 1)];
            }
        }
        let integrals = DMatrix::from_fn(samples, m, |k, l| match l {
            0 => p[(k, 1)],
            _ => (p[(k, l + 1)] - p[(k, l - 1)]) / (2 * l + 1) as f64,
        });
        let legendre = p.columns(0, m).into_owned();
        let (values, turn) = orthonormal(&legendre);
        Self {
            integral: values.transpose() * integrals * &turn,
            derivative: values.transpose() * d.columns(0, m) * &turn,
            line: values.transpose() * DVector::from_fn(samples, |k, _| at(k)),
            values,
        }
    }

    /// Number of polynomials.
    pub fn len(&self) -> usize {
        self.values.ncols()
    }

    /// Coefficients of samples.
    pub fn project(&self, samples: &[f64]) -> DVector<f64> {
        let mut out = DVector::zeros(self.len());
        vectorised(
            #[inline(always)]
            || {
                for (out, polynomial) in out.as_mut_slice().iter_mut().zip(self.polynomials()) {
                    *out = dot(polynomial, samples);
                }
            },
        );
        out
    }

    /// First coefficient of samples with this mean.
    pub fn level(&self, mean: f64) -> f64 {
        mean * (self.values.nrows() as f64).sqrt()
    }

    /// Values at the samples.
    pub fn at_samples(&self, coefficients: &DVector<f64>) -> Vec<f64> {
        let mut out = vec![0.0; self.values.nrows()];
        vectorised(
            #[inline(always)]
            || {
                for (coefficient, polynomial) in
                    coefficients.as_slice().iter().zip(self.polynomials())
                {
                    out.iter_mut()
                        .zip(polynomial)
                        .for_each(|(y, x)| *y += coefficient * x);
                }
            },
        );
        out
    }

    /// Values of one polynomial after the other at the samples.
    fn polynomials(&self) -> std::slice::ChunksExact<'_, f64> {
        self.values.as_slice().chunks_exact(self.values.nrows())
    }

    /// Coefficients of the integral over time; `half_s` is half the samples' extent in seconds.
    pub fn integrated(&self, coefficients: &DVector<f64>, half_s: f64) -> DVector<f64> {
        &self.integral * coefficients * half_s
    }

    /// Coefficients of the derivative with respect to time.
    pub fn derived(&self, coefficients: &DVector<f64>, half_s: f64) -> DVector<f64> {
        &self.derivative * coefficients / half_s
    }
}

/// Orthonormal columns of the same span, and the matrix that converts the given columns to them.
fn orthonormal(columns: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let (mut q, m) = (columns.clone(), columns.ncols());
    let mut turn = DMatrix::identity(m, m);
    for j in 0..m {
        // A second pass removes the rounding errors of the first.
        for _ in 0..2 {
            for l in 0..j {
                let along = q.column(l).dot(&q.column(j));
                let (ql, tl) = (q.column(l).into_owned(), turn.column(l).into_owned());
                q.column_mut(j).axpy(-along, &ql, 1.0);
                turn.column_mut(j).axpy(-along, &tl, 1.0);
            }
        }
        let norm = q.column(j).norm();
        q.column_mut(j).unscale_mut(norm);
        turn.column_mut(j).unscale_mut(norm);
    }
    (q, turn)
}

/// Bases by their number of samples; plateaus have two or three different ones.
#[derive(Debug, Default)]
pub(super) struct Bases(BTreeMap<usize, Rc<Basis>>);

impl Bases {
    /// Returns the basis for a number of samples.
    pub fn get_or_create(&mut self, samples: usize) -> Rc<Basis> {
        let samples = samples.max(MIN_SAMPLES);
        let new = || Rc::new(Basis::new(samples));
        Rc::clone(self.0.entry(samples).or_insert_with(new))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_sine_is_integrated_and_derived_as_calculus_does() {
        let mut bases = Bases::default();
        // Over two radian; a few samples have fewer polynomials.
        for (samples, tolerance) in [(7, 2e-4), (10, 2e-6), (130, 2e-7), (1301, 2e-7)] {
            let (dt_s, from) = (2.0 / (samples - 1) as f64, 0.3);
            let basis = bases.get_or_create(samples);
            let t = |k: usize| from + k as f64 * dt_s;
            let all: Vec<f64> = (0..samples).map(|k| t(k).sin()).collect();
            let sine = basis.project(&all);
            let fitted = basis.at_samples(&sine);
            let integral = basis.at_samples(&basis.integrated(&sine, 1.0));
            let derivative = basis.at_samples(&basis.derived(&sine, 1.0));
            for k in 0..samples {
                assert!((fitted[k] - t(k).sin()).abs() < tolerance, "{samples} {k}");
                // The integral's constant is free.
                let error = integral[k] - integral[0] + t(k).cos() - t(0).cos();
                assert!(error.abs() < 2.0 * tolerance, "{samples} {k}: {error:e}");
                let error = derivative[k] - t(k).cos();
                assert!(error.abs() < 60.0 * tolerance, "{samples} {k}: {error:e}");
            }
        }
    }

    #[test]
    fn noise_keeps_its_deviation() {
        let basis = Basis::new(40);
        let product = basis.values.transpose() * &basis.values;
        assert!((product - DMatrix::identity(9, 9)).norm() < 1e-12);
    }
}
