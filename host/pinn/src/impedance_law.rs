//! Dependence of the load's impedance on frequency, beyond the paper's eq. (1).
//!
//! Eddy currents make R and L of a pot depend on frequency, so that one R and one L cannot hold for the
//! fundamental and its harmonics at once. The law here is an inductance beside a fractional power of
//! s, Z(s) = s L_0 + K s^n: n = 1/2 is the diffusion of flux into a linear half-space, Z ∝ √(jω);
//! deep saturation (Agarwal's limiting law: X/R = 1/2) is near n = 0.3; n = 0 is eq. (1) itself.
//! R and L stay those of the fundamental,
//!
//!   R = K ω^n cos(nπ/2),   L = L_0 + R T/ω,   T = tan(nπ/2),
//!
//! and the impedance of harmonic h is linear in them: Z_h = jhω L + R (h^n (1 + jT) − jhT).
//! With a moving envelope the slope dZ/ds takes the place of L: V_h = Z_h I_h + (dZ/ds)_h I_h', with
//! dZ/ds = L + R/ω (n h^(n−1) (T − j) − T).

use std::f64::consts::FRAC_PI_2;

use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use crate::harmonic_branch::{HarmonicBasis, Phasors};

/// Largest order: a pure inductance would be 1, which is not separable from L_0.
pub(crate) const MAX_ORDER: f64 = 0.9;

/// Exponent n of the load's impedance, Z(s) = s L_0 + K s^n.
// Read as a value, not as `untagged`: that finds no float where anything in the build switches serde_json's
// arbitrary_precision on, as defmt's decoder does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, try_from = "serde_json::Value")]
pub enum ImpedanceOrder {
    /// Given order, 0..=0.9: 0 for R and L that hold at every harmonic, as in the paper's eq. (1); 0.5
    /// for eddy currents in a linear load.
    Given(f64),
    /// Order given by name.
    Named(NamedOrder),
}

/// Names of orders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NamedOrder {
    /// Order that fits the physics harmonics best, identified with R and L, one number per window.
    Identified,
}

impl TryFrom<serde_json::Value> for ImpedanceOrder {
    type Error = &'static str;

    fn try_from(value: serde_json::Value) -> Result<Self, Self::Error> {
        match value.as_f64() {
            Some(n) => Ok(Self::Given(n)),
            None => serde_json::from_value(value)
                .map(Self::Named)
                .map_err(|_| "impedance_order is a number or \"identified\""),
        }
    }
}

impl Default for ImpedanceOrder {
    fn default() -> Self {
        Self::Given(0.0)
    }
}

/// Law of one order at one harmonic, without R and L.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HarmonicLaw {
    /// Position of the harmonic in the basis.
    pub index: usize,
    /// ∂Z/∂R.
    z_by_r: Complex<f64>,
    /// ω ∂(dZ/ds)/∂R.
    slope_by_r: Complex<f64>,
    /// hω, rad/s.
    rate: f64,
    omega: f64,
}

impl HarmonicLaw {
    /// Creates the law of order `n` at the harmonic in position `index` of the basis.
    pub fn new(n: f64, basis: &HarmonicBasis, index: usize) -> Self {
        let (h, omega) = (f64::from(basis.harmonics[index]), basis.omega);
        let t = (n * FRAC_PI_2).tan();
        Self {
            index,
            z_by_r: Complex::new(1.0, t) * h.powf(n) - Complex::new(0.0, h * t),
            slope_by_r: Complex::new(t, -1.0) * (n * h.powf(n - 1.0)) - t,
            rate: h * omega,
            omega,
        }
    }

    /// Factors of R and L in V: V = R · first + L · second.
    pub fn columns(&self, at: &Phasors) -> (Complex<f64>, Complex<f64>) {
        let by_r = self.z_by_r * at.i + self.slope_by_r * at.slope / self.omega;
        (by_r, at.i * Complex::new(0.0, self.rate) + at.slope)
    }

    /// Z and dZ/ds for an R and an L.
    pub fn impedance(&self, r: f64, l: f64) -> (Complex<f64>, Complex<f64>) {
        (
            self.z_by_r * r + Complex::new(0.0, self.rate * l),
            self.slope_by_r * (r / self.omega) + l,
        )
    }
}

/// Order in 0..=[`MAX_ORDER`] with the least `misfit`, by golden section, which finds one of several
/// minima.
pub(crate) fn least(misfit: impl Fn(f64) -> f64) -> f64 {
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut from, mut to) = (0.0, MAX_ORDER);
    let (mut left, mut right) = (to - golden * to, golden * to);
    let (mut at_left, mut at_right) = (misfit(left), misfit(right));
    // 0.618^20 of the interval: the order to four digits.
    for _ in 0..20 {
        if at_left < at_right {
            (to, right, at_right) = (right, left, at_left);
            left = to - golden * (to - from);
            at_left = misfit(left);
        } else {
            (from, left, at_left) = (left, right, at_right);
            right = from + golden * (to - from);
            at_right = misfit(right);
        }
    }
    0.5 * (from + to)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn basis(omega: f64) -> HarmonicBasis {
        HarmonicBasis {
            spline: ihd_spline::CubicSpline::new(4, 10e-3),
            harmonics: vec![1, 3, 5, 7],
            omega,
            gains: vec![1.0; 4],
        }
    }

    /// Z(s) of an inductance beside a fractional element, straight from its definition.
    fn z(s: Complex<f64>, l_0: f64, k: f64, n: f64) -> Complex<f64> {
        s * l_0 + s.powf(n) * k
    }

    #[test]
    fn impedance_and_slope_at_every_harmonic_follow_from_r_and_l_of_the_fundamental() {
        let omega = std::f64::consts::TAU * 45e3;
        for n in [0.0, 0.3, 0.5, 0.8] {
            let (l_0, k) = (11e-6, 4.0 / omega.powf(n));
            let fundamental = z(Complex::new(0.0, omega), l_0, k, n);
            let (r, l) = (fundamental.re, fundamental.im / omega);
            for (index, h) in [1.0, 3.0, 5.0, 7.0].into_iter().enumerate() {
                let s = Complex::new(0.0, h * omega);
                let (found, slope) = HarmonicLaw::new(n, &basis(omega), index).impedance(r, l);
                let right = z(s, l_0, k, n);
                assert!((found - right).norm() < 1e-9 * right.norm());
                let step = Complex::new(0.0, 1e-4 * omega);
                let numeric = (z(s + step, l_0, k, n) - z(s - step, l_0, k, n)) / (step * 2.0);
                assert!((slope - numeric).norm() < 1e-6 * numeric.norm(), "{n} {h}");
            }
        }
    }

    #[test]
    fn order_zero_is_the_papers_equation() {
        let law = HarmonicLaw::new(0.0, &basis(3e5), 2);
        let (z, slope) = law.impedance(4.0, 20e-6);
        assert_eq!((z, slope.re), (Complex::new(4.0, 5.0 * 3e5 * 20e-6), 20e-6));
        assert_eq!(slope.im, 0.0);
    }

    #[test]
    fn the_columns_are_the_derivatives_of_the_voltage() {
        let law = HarmonicLaw::new(0.4, &basis(3e5), 1);
        let at = Phasors {
            v: Complex::new(0.0, 0.0),
            i: Complex::new(0.3, -0.7),
            slope: Complex::new(900.0, 400.0),
        };
        let (z, slope) = law.impedance(4.0, 20e-6);
        let (by_r, by_l) = law.columns(&at);
        let voltage = z * at.i + slope * at.slope;
        assert!((by_r * 4.0 + by_l * 20e-6 - voltage).norm() < 1e-12);
    }

    #[test]
    fn the_least_misfit_is_found() {
        assert!((least(|n| (n - 0.37).powi(2)) - 0.37).abs() < 1e-4);
        assert!(least(|n| n) < 1e-3 && least(|n| -n) > MAX_ORDER - 1e-3);
    }
}
