//! Fit of R and L as functions of the current's amplitude alone, which hold while the pot is not moved. A tone would hide in
//! R and L that may change at any time; here it stays in the residual. Only a tone of less than about five turns a
//! half-cycle hides by the half that is even about the crest.

use nalgebra::{Complex, DMatrix, DVector};

/// Polynomials of the amplitude for each of R and L.
const TERMS: usize = 6;

/// Smallest singular value that is used, as a share of the largest: a constant amplitude determines one term only.
const LEAST_SINGULAR: f64 = 1e-10;

/// One switching period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// Coil voltage in volt.
    pub v: Complex<f64>,
    /// Coil current in ampere.
    pub i: Complex<f64>,
    /// Derivative of the current, jωI + dI/dt, over ω, in ampere.
    pub d: Complex<f64>,
    /// Weight in the fit.
    pub weight: f64,
}

impl Period {
    /// Regressors of R's polynomials, then of ωL's; `largest` is the largest amplitude in ampere.
    fn factors(&self, largest: f64) -> [Complex<f64>; 2 * TERMS] {
        let x = 2.0 * self.i.norm() / largest - 1.0;
        let mut chebyshev = [1.0; TERMS];
        for k in 1..TERMS {
            chebyshev[k] = if k == 1 {
                x
            } else {
                2.0 * x * chebyshev[k - 1] - chebyshev[k - 2]
            };
        }
        std::array::from_fn(|k| {
            let of = if k < TERMS { self.i } else { self.d };
            of * chebyshev[k % TERMS]
        })
    }
}

/// Fits such a load and returns the voltage that it leaves in volt, period by period; `None` if there is no current.
pub fn residual(periods: &[Period]) -> Option<Vec<Complex<f64>>> {
    let largest = periods.iter().map(|p| p.i.norm()).fold(0.0, f64::max);
    if largest <= 0.0 {
        return None;
    }
    let mut a = DMatrix::<f64>::zeros(2 * TERMS, 2 * TERMS);
    let mut b = DVector::<f64>::zeros(2 * TERMS);
    for p in periods {
        let factors = p.factors(largest);
        for (m, x) in factors.iter().enumerate() {
            b[m] += p.weight * (x.conj() * p.v).re;
            for (n, y) in factors.iter().enumerate() {
                a[(m, n)] += p.weight * (x.conj() * y).re;
            }
        }
    }
    let svd = a.svd(true, true);
    let least = LEAST_SINGULAR * svd.singular_values.max();
    let solution = svd.solve(&b, least).ok()?;
    let left = |p: &Period| {
        let factors = p.factors(largest);
        let fitted: Complex<f64> = factors.iter().zip(&solution).map(|(x, c)| x * *c).sum();
        p.v - fitted
    };
    Some(periods.iter().map(left).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Periods with R = 3 − |I|/50 Ω and ωL = 5 Ω, and an additional voltage.
    fn periods(extra: impl Fn(usize) -> Complex<f64>) -> Vec<Period> {
        let period = |k: usize| {
            let amplitude = 40.0
                * (std::f64::consts::PI * (k as f64 + 0.5) / 500.0)
                    .sin()
                    .abs();
            let i = Complex::from_polar(amplitude, 0.3);
            let d = i * Complex::new(0.0, 1.0);
            let v = i * (3.0 - amplitude / 50.0) + d * 5.0 + extra(k);
            Period {
                v,
                i,
                d,
                weight: 1.0,
            }
        };
        (0..1000).map(period).collect()
    }

    #[test]
    fn a_load_that_depends_on_the_current_leaves_nothing() {
        let left = residual(&periods(|_| Complex::new(0.0, 0.0))).unwrap();
        assert!(left.iter().all(|x| x.norm() < 1e-6));
    }

    #[test]
    fn a_tone_is_left() {
        // Eight turns a half-cycle of 500 periods, 800 Hz: R(t) with an interval each .4 ms would follow it.
        let tone = |k: usize| Complex::from_polar(8.0, 0.1005 * k as f64);
        let left = residual(&periods(tone)).unwrap();
        let seen: Complex<f64> = left
            .iter()
            .enumerate()
            .map(|(k, x)| x * tone(k).conj())
            .sum();
        let share = seen / (64.0 * 1000.0);
        assert!((share - 1.0).norm() < 0.15, "{share}");
    }
}
