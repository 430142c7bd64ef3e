//! Correction of the RL-MLP: B-splines on top of its R(t) and ωL(t), in the same physics term (4), with a
//! normal prior whose width the evidence chooses.
//!
//! A network weighted with I² fits the ends of the half-cycle badly, where R and L change fastest. With
//! noise the evidence supports no correction and the splines vanish; without noise they fit the rest.

use ihd_spline::CubicSpline;
use nalgebra::{DMatrix, DVector};

use crate::loss::SlowPhysics;
use crate::normal_matrix::Factor;
use crate::parameters::OUTPUTS;

/// Possible widths of the prior, as shares of |Z| at full current.
const WIDTHS: [f64; 9] = [1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1];

/// Exponent with which the width grows as the current falls. The error of a network weighted with I² is at the ends, and
/// without this growth the middle, which needs no correction, would suppress the evidence for the ends.
const GROWTH: f64 = 1.5;

/// Least log evidence of a correction over none.
const MIN_EVIDENCE: f64 = 1.0;

/// Splines on R and L, in the network's units.
pub(crate) struct Correction {
    spline: CubicSpline,
    /// R and L of each function, alternating.
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// Problem that the correction is fitted to.
pub(crate) struct Problem<'a> {
    pub physics: &'a SlowPhysics,
    /// The network's residuals, R rows above L rows.
    pub residuals: &'a [f64],
    pub spline: &'a CubicSpline,
    /// Variance of one residual.
    pub noise: f64,
    /// |Z| in units of R's and of ωL's output.
    pub z: [f64; OUTPUTS],
}

impl Correction {
    /// Fits splines of the most evident width; `None` if the network alone explains the residuals as well.
    pub fn fit(problem: &Problem<'_>) -> Option<Self> {
        let (gram, right) = problem.normal_equations();
        let precision = problem.precision();
        let evidence = |width: f64| -> Option<(f64, Factor)> {
            let mut posterior = gram.clone();
            let mut log_prior = 0.0;
            for (k, p) in precision.iter().enumerate() {
                let p = p / (width * width);
                posterior[(k, k)] += p;
                log_prior += p.ln();
            }
            let factor = Factor::new(&posterior, 0.0)?;
            let explained = right.dot(&factor.solve(&right));
            let evidence = 0.5 * (explained + log_prior - factor.log_determinant());
            Some((evidence, factor))
        };
        let all = WIDTHS.into_iter().filter_map(evidence);
        let (most, factor) = all.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (most > MIN_EVIDENCE).then(|| Self {
            spline: problem.spline.clone(),
            coefficients: factor.solve(&right),
            covariance: factor.inverse(),
        })
    }

    /// Values added to R / r_scale and L / l_scale at `tau_s` seconds after the first point, and their variances.
    pub fn at(&self, tau_s: f64) -> ([f64; OUTPUTS], [f64; OUTPUTS]) {
        let local = self.spline.at(tau_s);
        let index = |m: usize, output: usize| OUTPUTS * (local.first + m) + output;
        let value = |output| {
            let terms = local.values.iter().enumerate();
            terms
                .map(|(m, b)| b * self.coefficients[index(m, output)])
                .sum()
        };
        let variance = |output| {
            let mut sum = 0.0;
            for (m, x) in local.values.iter().enumerate() {
                for (n, y) in local.values.iter().enumerate() {
                    sum += x * y * self.covariance[(index(m, output), index(n, output))];
                }
            }
            f64::max(sum, 0.0)
        };
        (std::array::from_fn(value), std::array::from_fn(variance))
    }
}

impl Problem<'_> {
    /// AᵀA/s² and Aᵀe/s², A being the residuals' derivatives by the coefficients.
    fn normal_equations(&self) -> (DMatrix<f64>, DVector<f64>) {
        let size = OUTPUTS * self.spline.functions();
        let (mut gram, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let count = self.physics.tau_s.len();
        let weight = 1.0 / (self.noise + self.floor());
        for (k, tau_s) in self.physics.tau_s.iter().enumerate() {
            let local = self.spline.at(*tau_s);
            let first = OUTPUTS * local.first;
            for (row, e) in [(0, self.residuals[k]), (1, self.residuals[count + k])] {
                let by = self.physics.by_output(k, row);
                let slopes: [f64; 4 * OUTPUTS] =
                    std::array::from_fn(|m| local.values[m / OUTPUTS] * by[m % OUTPUTS]);
                for (m, x) in slopes.iter().enumerate() {
                    right[first + m] += weight * x * e;
                    for (n, y) in slopes.iter().enumerate() {
                        gram[(first + m, first + n)] += weight * x * y;
                    }
                }
            }
        }
        (gram, right)
    }

    /// Least variance of a residual: the error of the phasors' splines, 1e-6 of the voltage.
    fn floor(&self) -> f64 {
        1e-12 * self.physics.mean_square()
    }

    /// One over the variance of each coefficient for a width of 1.
    fn precision(&self) -> Vec<f64> {
        let functions = self.spline.functions();
        let currents: Vec<f64> = (0..self.physics.tau_s.len())
            .map(|k| self.physics.by_output(k, 0)[0].abs())
            .collect();
        let largest = currents.iter().copied().fold(0.0, f64::max);
        // The current around each function's middle: the mean of the times weighted with it.
        let (mut sums, mut weights) = (vec![0.0; functions], vec![1e-300; functions]);
        for (tau_s, current) in self.physics.tau_s.iter().zip(&currents) {
            let local = self.spline.at(*tau_s);
            for (m, b) in local.values.iter().enumerate() {
                sums[local.first + m] += b * current;
                weights[local.first + m] += b;
            }
        }
        let shares = sums
            .iter()
            .zip(&weights)
            .map(|(s, w)| (s / w / largest).clamp(1e-2, 1.0));
        shares
            .flat_map(|share| self.z.map(|z| share.powf(2.0 * GROWTH) / (z * z)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::Parameters;
    use crate::trial;

    /// Correction of a network on the constant load of the trial, 4 ohm and 20 uH, and the outputs with it.
    fn corrected(network: &Parameters, noise: f64) -> Option<[f64; OUTPUTS]> {
        let samples = trial::samples();
        let branch = trial::fitted(&samples);
        let physics = trial::physics(&branch, &samples, network, &[0], 64);
        let outputs = |tau_s: f64| {
            let (r, l) = network.r_l_at(samples.t0_s + tau_s);
            [r / network.r_scale_ohm, l / network.l_scale_h]
        };
        let all: Vec<_> = physics.tau_s.iter().map(|tau| outputs(*tau)).collect();
        let z = 4.0_f64.hypot(20e-6 * samples.omega);
        let problem = Problem {
            physics: &physics,
            residuals: &physics.residuals(&all),
            spline: &branch.basis.spline,
            noise,
            z: [
                z / network.r_scale_ohm,
                z / (samples.omega * network.l_scale_h),
            ],
        };
        let added = Correction::fit(&problem)?.at(5e-3).0;
        let before = outputs(5e-3);
        Some([before[0] + added[0], before[1] + added[1]])
    }

    #[test]
    fn what_the_network_is_off_by_is_taken_up_without_noise() {
        // The untrained network is at about 5 ohm and 25 uH.
        let found = corrected(&trial::network(), 1e-14).expect("there is something to explain");
        assert!(
            (found[0] - 1.0).abs() < 2e-3 && (found[1] - 1.0).abs() < 2e-3,
            "{found:?}"
        );
    }

    #[test]
    fn a_network_that_explains_the_samples_is_left_alone() {
        let right = trial::network().constant([1.0, 1.0]);
        assert_eq!(corrected(&right, 1e-7), None);
    }
}
