//! R and L as functions of the current's amplitude alone, which hold while the pot is not moved; and the space of what such a
//! load, a slow drift and tones beside the carrier explain. A load follows the amplitude at once, or within a switching period.
//!
//! A tone would hide in R and L that may change at any time. In a static law it cannot: within a half-cycle each amplitude comes
//! twice, and where a tone disturbs R evenly about the crest it disturbs L oddly.

use std::f64::consts::TAU;

use ihd_signal::vectorised::{dot, vectorised};
use nalgebra::Complex;

/// Polynomials of the amplitude for each of R and L.
const TERMS: usize = 6;

/// Lags in switching periods of R and L behind the amplitude; the one that leaves least is taken. A sensor's own lag makes the
/// apparent R small, and then half a period is .4 % of it.
const LAGS: [f64; 3] = [0.0, 0.5, 1.0];

/// Share of a column that must lie outside the others: a constant amplitude determines one term only.
const MIN_NEW: f64 = 1e-5;

/// Phasors of one switching period, or their mean over some.
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
    /// Amplitude in ampere so many switching periods earlier.
    fn amplitude_before(&self, periods: f64) -> f64 {
        let a = self.i.norm();
        let slope = self.d - self.i * Complex::new(0.0, 1.0);
        match a > 0.0 {
            true => (a - TAU * periods * (slope * self.i.conj()).re / a).max(0.0),
            false => 0.0,
        }
    }
}

/// Largest amplitude in ampere; `None` if there is no current.
fn largest_a(periods: &[Period]) -> Option<f64> {
    let largest = periods.iter().map(|p| p.i.norm()).fold(0.0, f64::max);
    (largest > 0.0).then_some(largest)
}

/// Values of a complex quantity over the periods, times the root of the weight: real parts, then imaginary parts.
pub fn weighed(periods: &[Period], of: impl Fn(usize, &Period) -> Complex<f64>) -> Vec<f64> {
    let mut out = vec![0.0; 2 * periods.len()];
    let (re, im) = out.split_at_mut(periods.len());
    for (k, p) in periods.iter().enumerate() {
        let x = of(k, p) * p.weight.sqrt();
        (re[k], im[k]) = (x.re, x.im);
    }
    out
}

/// Linear space with an orthonormal basis.
#[derive(Clone, Debug, Default)]
pub struct Space {
    basis: Vec<Vec<f64>>,
    /// Lag of the static load, in switching periods.
    lag: f64,
}

impl Space {
    /// Space of the voltages of static laws, with the lag that leaves least; `None` if there is no current.
    pub fn of_static_loads(periods: &[Period]) -> Option<Self> {
        let v = weighed(periods, |_, p| p.v);
        let left = |space: &Self| {
            let left = space.outside(&v);
            dot(&left, &left)
        };
        let all = LAGS.iter().filter_map(|lag| Self::with_lag(periods, *lag));
        all.map(|space| (left(&space), space))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, space)| space)
    }

    /// Space of static laws of other periods, with this one's lag; `None` if there is no current.
    pub fn alike(&self, periods: &[Period]) -> Option<Self> {
        Self::with_lag(periods, self.lag)
    }

    fn with_lag(periods: &[Period], lag: f64) -> Option<Self> {
        let largest_a = largest_a(periods)?;
        let mut space = Self {
            basis: Vec::new(),
            lag,
        };
        let x: Vec<f64> = periods
            .iter()
            .map(|p| (2.0 * p.amplitude_before(lag) / largest_a - 1.0).clamp(-1.0, 1.0))
            .collect();
        // Chebyshev polynomials: T₋₁ = x, T₀ = 1, Tₙ₊₁ = 2 x Tₙ − Tₙ₋₁.
        let (mut before, mut shape) = (x.clone(), vec![1.0; x.len()]);
        for _ in 0..TERMS {
            space.add(weighed(periods, |k, p| p.i * shape[k]));
            space.add(weighed(periods, |k, p| p.d * shape[k]));
            for ((x, before), shape) in x.iter().zip(&mut before).zip(&mut shape) {
                (*before, *shape) = (*shape, 2.0 * x * *shape - *before);
            }
        }
        Some(space)
    }

    /// Adds R and L that change in proportion to time.
    pub fn add_drift(&mut self, periods: &[Period]) {
        let at = |k: usize| 2.0 * k as f64 / periods.len() as f64 - 1.0;
        self.add(weighed(periods, |k, p| p.i * at(k)));
        self.add(weighed(periods, |k, p| p.d * at(k)));
    }

    /// Puts so many periods, of which the space says nothing, before and after its own.
    pub fn widen(&mut self, before: usize, after: usize) {
        for b in &mut self.basis {
            let (re, im) = b.split_at(b.len() / 2);
            let part = |x: &[f64]| [&vec![0.0; before], x, &vec![0.0; after]].concat();
            *b = [part(re), part(im)].concat();
        }
    }

    /// Adds the dimensions of a space that is orthogonal to this one.
    pub fn join(&mut self, other: Self) {
        self.basis.extend(other.basis);
    }

    /// Number of its dimensions.
    pub fn dimension(&self) -> usize {
        self.basis.len()
    }

    /// Adds a column, unless it lies in the space.
    pub fn add(&mut self, column: Vec<f64>) {
        let whole = dot(&column, &column).sqrt();
        // Twice, because the first pass leaves rounding of the removed part.
        let mut left = self.outside(&self.outside(&column));
        let norm = dot(&left, &left).sqrt();
        if norm > MIN_NEW * whole {
            left.iter_mut().for_each(|x| *x /= norm);
            self.basis.push(left);
        }
    }

    /// Coordinates of a vector's part inside.
    pub fn inside(&self, x: &[f64]) -> Vec<f64> {
        self.basis.iter().map(|b| dot(b, x)).collect()
    }

    /// A vector's part outside.
    pub fn outside(&self, x: &[f64]) -> Vec<f64> {
        let mut left = x.to_vec();
        vectorised(
            #[inline(always)]
            || {
                for b in &self.basis {
                    let share = dot(b, &left);
                    left.iter_mut().zip(b).for_each(|(x, b)| *x -= share * b);
                }
            },
        );
        left
    }
}

/// Fits a static load and returns the voltage that it leaves in volt, period by period; `None` if there is no current.
pub fn residual(periods: &[Period]) -> Option<Vec<Complex<f64>>> {
    let space = Space::of_static_loads(periods)?;
    let left = space.outside(&weighed(periods, |_, p| p.v));
    let (re, im) = left.split_at(periods.len());
    let unweighed = |(k, p): (usize, &Period)| {
        let root = p.weight.sqrt();
        match root > 0.0 {
            true => Complex::new(re[k], im[k]) / root,
            false => Complex::new(0.0, 0.0),
        }
    };
    Some(periods.iter().enumerate().map(unweighed).collect())
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

    /// One turn a half-cycle: as slow as the load's own change, and its sidebands are those of the mains.
    #[test]
    fn a_tone_at_twice_the_mains_frequency_is_left() {
        for phase in [0.0, 0.8, 1.6, 2.4] {
            let turn = 2.0 * std::f64::consts::PI / 500.0;
            let tone = |k: usize| Complex::from_polar(4.0, phase + turn * k as f64);
            let left = residual(&periods(tone)).unwrap();
            let power = left.iter().map(Complex::norm_sqr).sum::<f64>() / 16e3;
            assert!((0.2..1.0).contains(&power), "{phase}: {power}");
        }
    }
}
