//! Clamped uniform cubic B-splines in slow time.
//!
//! A window lies between two mains zero crossings, where the envelope has its only kinks. One smooth piece with clamped
//! ends is therefore enough, without inner knots of higher multiplicity.

use std::f64::consts::FRAC_PI_2;

use ihd_signal::vectorised::ln;

const DEGREE: usize = 3;

/// Largest noise of a phasor in the first interval, as a share of its amplitude there. More would bias R and L, because
/// noise of the current is noise of the regressor.
const END_NOISE: f64 = 0.01;

/// Shortest interval at a mains zero crossing, in seconds, over which noise leaves the phasor accurate to 1 % of its amplitude
/// there. `noise` is the variance of one sample's white noise over the mean square of the signal, `dt_s` the time between
/// samples in seconds. Infinite if `noise` is.
pub fn quiet_interval_s(noise: f64, dt_s: f64, half_cycle_s: f64) -> f64 {
    // The largest amplitude of a half-cycle is twice its rms, and within the first interval half its slope.
    let slope = FRAC_PI_2 * 2.0 / half_cycle_s;
    let cube = 2.0 * noise * dt_s / (END_NOISE * slope).powi(2);
    if cube.is_finite() {
        libm::cbrt(cube)
    } else {
        f64::INFINITY
    }
}

/// Basis of cubic B-splines on `[0, duration]`.
#[derive(Debug, Clone, PartialEq)]
pub struct CubicSpline {
    intervals: usize,
    duration_s: f64,
    /// k of the knots' density k/(atanh k · (1 − k²x²)), x from −1 to 1 over the duration; 0 if uniform.
    grading: f64,
    /// atanh of `grading`.
    whole: f64,
}

/// Possible gradings: the knots at the ends are 3.2, 2.0, 1.5 or 1.2 times as dense as on average.
const GRADINGS: [f64; 4] = [0.9, 0.8, 0.68, 0.5];

/// The four basis functions that are non-zero at one time.
#[derive(Debug, Clone, Copy)]
pub struct BasisValues {
    /// Index of the first of the four functions.
    pub first: usize,
    /// Values of the four functions.
    pub values: [f64; 4],
    /// Time derivatives of the four functions in 1/s.
    pub slopes_per_s: [f64; 4],
}

impl CubicSpline {
    /// Creates a basis of that many intervals, at least one, over `duration_s` seconds.
    pub fn new(intervals: usize, duration_s: f64) -> Self {
        Self {
            intervals: intervals.max(1),
            duration_s,
            grading: 0.0,
            whole: 0.0,
        }
    }

    /// Creates a basis with denser knots toward both ends, where a mains half-cycle has its steepest relative changes. No
    /// interval is shorter than `least_s` seconds if that is possible.
    pub fn graded(intervals: usize, duration_s: f64, least_s: f64) -> Self {
        let uniform = Self::new(intervals, duration_s);
        let all = GRADINGS.map(|grading| Self {
            grading,
            whole: libm::atanh(grading),
            ..uniform.clone()
        });
        let fits = |s: &Self| duration_s >= least_s * s.intervals as f64 * s.place(0.0).1;
        all.into_iter().find(fits).unwrap_or(uniform)
    }

    /// Position of a share of the duration among the knots, as a share of all intervals, and its derivative.
    fn place(&self, share: f64) -> (f64, f64) {
        let k = self.grading;
        if k == 0.0 {
            return (share, 1.0);
        }
        let x = k * (2.0 * share - 1.0);
        (
            0.5 + 0.5 * libm::atanh(x) / self.whole,
            k / (self.whole * (1.0 - x * x)),
        )
    }

    /// Position of a time in seconds among the knots, in intervals, as [`Self::values_at`] finds it to rounding; without branches,
    /// for use within [`vectorised`](ihd_signal::vectorised::vectorised).
    #[inline(always)]
    pub(crate) fn position(&self, tau_s: f64) -> f64 {
        let share = (tau_s / self.duration_s).clamp(0.0, 1.0);
        let x = self.grading * (2.0 * share - 1.0);
        // artanh x = ½ ln((1 + x)/(1 − x)).
        let graded = 0.5 + 0.25 * ln((1.0 + x) / (1.0 - x)) / self.whole;
        let place = if self.grading == 0.0 { share } else { graded };
        (place * self.intervals as f64).clamp(0.0, self.intervals as f64)
    }

    /// Interval of a position, which is the index of its first function.
    #[inline(always)]
    pub(crate) fn interval(&self, position: f64) -> usize {
        (position as usize).min(self.intervals - 1)
    }

    /// Polynomials of the four functions in an interval: coefficients by power of the position beyond the interval's beginning.
    pub(crate) fn polynomials(&self, interval: usize) -> [[f64; 4]; 4] {
        let thirds =
            [0.0, 1.0, 2.0, 3.0].map(|k| self.basis::<3>(interval, interval as f64 + k / 3.0));
        std::array::from_fn(|m| {
            let [a, b, c, d] = thirds.map(|values| values[m]);
            [
                a,
                0.5 * (-11.0 * a + 18.0 * b - 9.0 * c + 2.0 * d),
                4.5 * (2.0 * a - 5.0 * b + 4.0 * c - d),
                4.5 * (-a + 3.0 * b - 3.0 * c + d),
            ]
        })
    }

    /// Number of basis functions.
    pub fn functions(&self) -> usize {
        self.intervals + DEGREE
    }

    /// Knot `index` in units of intervals; the first and last four coincide (clamped ends).
    fn knot(&self, index: usize) -> f64 {
        index.saturating_sub(DEGREE).min(self.intervals) as f64
    }

    /// Greville abscissa of a function in seconds: the mean of its inner knots, where it counts most.
    pub fn centre_s(&self, function: usize) -> f64 {
        let mean = (1..=DEGREE).map(|m| self.knot(function + m)).sum::<f64>() / DEGREE as f64;
        let place = mean / self.intervals as f64;
        let share = match self.grading {
            0.0 => place,
            k => 0.5 + 0.5 * libm::tanh(self.whole * (2.0 * place - 1.0)) / k,
        };
        share * self.duration_s
    }

    /// Index of the first basis function that is not zero at `tau_s`, and the values of the four: [`Self::at`] without
    /// the slopes.
    pub fn values_at(&self, tau_s: f64) -> (usize, [f64; 4]) {
        let (place, _) = self.place((tau_s / self.duration_s).clamp(0.0, 1.0));
        let u = (place * self.intervals as f64).clamp(0.0, self.intervals as f64);
        let first = self.interval(u);
        if first < 2 || first + 3 > self.intervals {
            return (first, self.basis::<3>(first, u));
        }
        // Between knots that are all one apart.
        let x = u - first as f64;
        let (y, x2) = (1.0 - x, x * x);
        let values = [
            y * y * y / 6.0,
            (0.5 * x - 1.0) * x2 + 2.0 / 3.0,
            (0.5 * y - 1.0) * y * y + 2.0 / 3.0,
            x2 * x / 6.0,
        ];
        (first, values)
    }

    /// Non-zero basis functions at `tau_s`, which is clamped to the basis' range.
    pub fn at(&self, tau_s: f64) -> BasisValues {
        let (place, density) = self.place((tau_s / self.duration_s).clamp(0.0, 1.0));
        let per_interval_s = self.duration_s / (self.intervals as f64 * density);
        let u = (place * self.intervals as f64).clamp(0.0, self.intervals as f64);
        let first = self.interval(u);
        let quadratic = self.basis::<2>(first, u);
        let values = self.basis::<3>(first, u);
        // B'_j = 3 (Q_j / (k_{j+3} - k_j) - Q_{j+1} / (k_{j+4} - k_{j+1})), Q the quadratics; of
        // those only first+1..=first+3 are non-zero.
        let weighted: [f64; 5] = std::array::from_fn(|m| match m {
            1..=3 => {
                let j = first + m;
                3.0 * quadratic[m - 1] / (self.knot(j + DEGREE) - self.knot(j))
            }
            _ => 0.0,
        });
        BasisValues {
            first,
            values,
            slopes_per_s: std::array::from_fn(|m| (weighted[m] - weighted[m + 1]) / per_interval_s),
        }
    }

    /// Cox-de Boor recursion up to degree `D` in knot span `first`; entries beyond `D` stay zero.
    fn basis<const D: usize>(&self, first: usize, u: f64) -> [f64; 4] {
        let span = first + DEGREE;
        let mut basis = [0.0; 4];
        basis[0] = 1.0;
        for degree in 1..=D {
            let mut saved = 0.0;
            for (r, value) in basis.iter_mut().enumerate().take(degree) {
                let right = self.knot(span + r + 1);
                let left = self.knot(span + 1 + r - degree);
                let part = *value / (right - left);
                *value = saved + (right - u) * part;
                saved = (u - left) * part;
            }
            basis[degree] = saved;
        }
        basis
    }
}

#[cfg(test)]
mod tests {
    use super::CubicSpline;

    fn times() -> impl Iterator<Item = f64> {
        (0..=500).map(|n| f64::from(n) * 0.01 / 500.0)
    }

    #[test]
    fn the_basis_sums_to_one_and_its_slopes_to_zero() {
        for spline in [CubicSpline::new(7, 0.01), CubicSpline::graded(7, 0.01, 0.0)] {
            for tau in times() {
                let local = spline.at(tau);
                assert!((local.values.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                assert!(local.slopes_per_s.iter().sum::<f64>().abs() < 1e-8);
                assert!(local.first + 4 <= spline.functions());
            }
        }
    }

    #[test]
    fn values_alone_are_the_same() {
        for intervals in [1, 3, 5, 9] {
            let spline = CubicSpline::graded(intervals, 0.01, 0.0);
            for tau in times() {
                let (local, (first, values)) = (spline.at(tau), spline.values_at(tau));
                assert_eq!(local.first, first);
                let differ = |m: usize| (local.values[m] - values[m]).abs();
                assert!((0..4).map(differ).sum::<f64>() < 1e-15);
            }
        }
    }

    #[test]
    fn polynomials_of_the_intervals_are_the_functions() {
        for spline in [CubicSpline::new(6, 0.01), CubicSpline::graded(6, 0.01, 0.0)] {
            for tau in times() {
                let (first, values) = spline.values_at(tau);
                let position = spline.position(tau);
                // At a knot rounding decides.
                let interval = spline.interval(position);
                assert!(interval == first || (position - position.round()).abs() < 1e-14);
                let x = position - first as f64;
                for (value, of) in values.iter().zip(spline.polynomials(first)) {
                    let sum = of.iter().rev().fold(0.0, |sum, c| sum * x + c);
                    assert!((sum - value).abs() < 3e-15);
                }
            }
        }
    }

    #[test]
    fn greville_abscissae_reproduce_a_straight_line_and_its_slope() {
        let spline = CubicSpline::new(9, 0.01);
        let greville = |j| spline.centre_s(j) / 0.01;
        for tau in times() {
            let local = spline.at(tau);
            let line: f64 = (0..4)
                .map(|m| local.values[m] * greville(local.first + m))
                .sum();
            let slope: f64 = (0..4)
                .map(|m| local.slopes_per_s[m] * greville(local.first + m))
                .sum();
            assert!((line - tau / 0.01).abs() < 1e-12);
            assert!((slope - 100.0).abs() < 1e-9);
        }
        // In intervals graded knots lie as even ones.
        let graded = CubicSpline::graded(9, 0.01, 0.0);
        for j in 0..spline.functions() {
            let off = graded.position(graded.centre_s(j)) - 9.0 * greville(j);
            assert!(off.abs() < 1e-12);
        }
    }

    #[test]
    fn slopes_are_the_derivative_of_the_values() {
        let step = 1e-8;
        for spline in [CubicSpline::new(6, 0.01), CubicSpline::graded(6, 0.01, 0.0)] {
            for tau in times().skip(1).step_by(7).filter(|t| *t < 0.0099) {
                let (before, here, after) =
                    (spline.at(tau - step), spline.at(tau), spline.at(tau + step));
                if before.first == after.first {
                    for m in 0..4 {
                        let numeric = (after.values[m] - before.values[m]) / (2.0 * step);
                        assert!((numeric - here.slopes_per_s[m]).abs() < 2e-3);
                    }
                }
            }
        }
    }

    #[test]
    fn graded_intervals_are_short_at_the_ends_and_no_shorter_than_allowed() {
        let intervals = |spline: &CubicSpline| {
            let ends: Vec<f64> = times()
                .zip(times().skip(1))
                .filter(|(a, b)| spline.at(*a).first != spline.at(*b).first)
                .map(|(_, b)| b)
                .collect();
            (ends[0], ends[6] - ends[5])
        };
        let (first, middle) = intervals(&CubicSpline::graded(12, 0.01, 0.0));
        assert!(first < 0.4e-3 && middle > 1.1e-3, "{first} {middle}");
        // Twelve equal intervals are .83 ms.
        let (first, _) = intervals(&CubicSpline::graded(12, 0.01, 0.5e-3));
        assert!((0.5e-3..0.8e-3).contains(&first), "{first}");
        let (first, middle) = intervals(&CubicSpline::graded(12, 0.01, 1e-3));
        assert!((first - middle).abs() < 0.1e-3);
    }
}
