//! Rational cubic splines, Σ B_j q_j c_j / Σ B_j q_j, with weights q that follow the current's amplitude.
//!
//! At small currents R rises nearly as 1/|I|. Cubic splines, even in time, follow that with some .3 %; here R·|I| is a cubic spline
//! over another one that approximates |I|. Functions near a zero crossing weigh little, so that noise does not bend R there. A
//! constant remains exact: all c_j alike.

use ihd_spline::CubicSpline;

/// Least weight of a function, as a share of the largest amplitude.
const MIN_WEIGHT: f64 = 1e-3;

/// Basis of rational cubic splines.
pub struct RationalSpline {
    spline: CubicSpline,
    weights: Vec<f64>,
}

/// Values of the four functions that are non-zero at one time; their sum is one.
pub struct RationalValues {
    /// Index of the first of the four functions.
    pub first: usize,
    /// Values of the four functions.
    pub values: [f64; 4],
}

impl RationalSpline {
    /// Creates a basis on the knots of `spline` from the current's amplitude in ampere over time in seconds, and its largest one.
    pub fn new(spline: CubicSpline, amplitude_a: impl Fn(f64) -> f64, largest_a: f64) -> Self {
        let weight = |j| amplitude_a(spline.centre_s(j)).max(MIN_WEIGHT * largest_a);
        Self {
            weights: (0..spline.functions()).map(weight).collect(),
            spline,
        }
    }

    /// Number of basis functions.
    pub fn functions(&self) -> usize {
        self.weights.len()
    }

    /// Non-zero basis functions at `tau_s` seconds.
    pub fn at(&self, tau_s: f64) -> RationalValues {
        let (first, mut values) = self.spline.values_at(tau_s);
        for (value, weight) in values.iter_mut().zip(&self.weights[first..]) {
            *value *= weight;
        }
        let sum: f64 = values.iter().sum();
        RationalValues {
            first,
            values: values.map(|value| value / sum),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::{CubicSpline, RationalSpline};

    /// The largest relative error of the values at the functions' centres as coefficients, between the first and the last
    /// interval.
    fn error(of: impl Fn(f64) -> f64, amplitude: impl Fn(f64) -> f64) -> f64 {
        let basis = RationalSpline::new(CubicSpline::new(24, 0.01), amplitude, 1.0);
        let coefficients: Vec<f64> = (0..basis.functions())
            .map(|j| of(basis.spline.centre_s(j).clamp(1e-4, 9.9e-3)))
            .collect();
        (42..=958)
            .map(|n| {
                let tau_s = f64::from(n) * 1e-5;
                let local = basis.at(tau_s);
                let value: f64 = (0..4)
                    .map(|m| local.values[m] * coefficients[local.first + m])
                    .sum();
                (value / of(tau_s) - 1.0).abs()
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn constants_are_exact_and_a_pole_at_the_crossing_is_followed() {
        let current = |tau_s: f64| (PI * tau_s / 0.01).sin();
        assert!(error(|_| 2.5, current) < 1e-14);
        let pole = |tau_s: f64| 1.0 / current(tau_s);
        let (rational, even) = (error(pole, current), error(pole, |_| 1.0));
        assert!(rational < 0.1 * even, "{rational} {even}");
    }
}
