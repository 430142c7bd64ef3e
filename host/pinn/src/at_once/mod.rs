//! R and L of a window at once, without a network: a law R(I), L(I) and a part that differs between the flanks of the
//! half-cycle, both normal processes whose widths were learned from simulated loads ([`Widths::LEARNED`]). With them the
//! physics term of eq. (4) is a quadratic function of the unknowns: R, L and their deviations follow in closed form.
//!
//!   R / R₀ = 1 + r(z) + cos(φ) r'(z),   L / L₀ = 1 + l(z) + cos(φ) l'(z),   z = ln(1 + I/4 A),
//!
//! I being the amplitude of the current's fundamental, φ the mains' phase, R₀ and L₀ the constant load that fits best.
//! A load unlike those learned from leaves a residual, which decides whether the network is needed ([`LawFit::holds`]).

#[cfg(test)]
mod loads;
mod prior;
#[cfg(test)]
mod recipe;
#[cfg(test)]
mod tests;
mod widths;

use ihd_spline::CubicSpline;
use nalgebra::{DMatrix, DVector};

use self::prior::precision;
pub(crate) use self::widths::Widths;
use crate::loss::SlowPhysics;
use crate::normal_matrix::{Factor, gram, transposed_times};
use crate::parameters::OUTPUTS;

/// Current in ampere beyond which equal ratios of it are equal steps of the law's axis.
const KNEE_A: f64 = 4.0;

/// Intervals of the law's splines, and of those of the flanks' difference.
const INTERVALS: [usize; 2] = [11, 3];

/// Standard deviation of R₀ and L₀ relative to the constant load that fits best.
const LEVEL: f64 = 0.1;

/// Most mean residual of the load, relative to what is no fault of it, at which the law holds.
const MAX_RESIDUAL: f64 = 0.6;

/// Place in a half-cycle: the current's amplitude in ampere and the cosine of the mains' phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct HalfCyclePoint {
    pub i_a: f64,
    pub cosine: f64,
}

/// Problem of a window.
#[derive(Debug)]
pub(crate) struct Window {
    pub physics: SlowPhysics,
    /// Place at each slow time.
    pub places: Vec<HalfCyclePoint>,
    /// Variance of one residual.
    pub noise: f64,
}

/// Law that fits a window, with its covariance.
#[derive(Debug)]
pub(crate) struct LawFit {
    splines: [CubicSpline; 2],
    constant: [f64; OUTPUTS],
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Logarithm of the probability of the window's residuals with these widths, up to a constant of the window.
    #[cfg_attr(not(test), expect(dead_code, reason = "the recipe maximises it"))]
    pub log_evidence: f64,
}

/// Non-zero functions of one output at a place.
type Row = [(usize, f64); 8];

impl LawFit {
    /// Fits the law; `None` if rounding leaves no solution.
    pub fn new(window: &Window, widths: &Widths) -> Option<Self> {
        let physics = &window.physics;
        let most_a = window.places.iter().fold(0.0, |m, p| f64::max(m, p.i_a));
        let reach = axis(most_a).max(1e-3);
        let splines = INTERVALS.map(|intervals| CubicSpline::new(intervals, reach));
        let constant = physics.best_constant();
        let functions: usize = splines.iter().map(CubicSpline::functions).sum();
        let size = OUTPUTS * functions;
        let count = window.places.len();
        let scale = (window.noise + 1e-12 * physics.mean_square())
            .sqrt()
            .recip();
        let mut residuals = physics.residuals(&vec![constant; count]);
        residuals.iter_mut().for_each(|e| *e *= scale);
        let mut slopes = DMatrix::zeros(OUTPUTS * count, size);
        for (k, place) in window.places.iter().enumerate() {
            for (at, value) in row(&splines, *place) {
                for half in 0..OUTPUTS {
                    let by = physics.by_output(k, half);
                    for o in 0..OUTPUTS {
                        slopes[(half * count + k, o * functions + at)] =
                            scale * value * by[o] * constant[o];
                    }
                }
            }
        }
        let mut normal = gram(&slopes);
        let right = transposed_times(&slopes, &residuals);
        let squares: f64 = residuals.iter().map(|e| e * e).sum();
        let mut log_prior = 0.0;
        for (o, (law, flanks)) in widths.processes().into_iter().enumerate() {
            let mut first = o * functions;
            for (spline, process) in splines.iter().zip([law, flanks]) {
                let (precision, log_determinant) = precision(spline, reach, &process)?;
                let size = spline.functions();
                let mut block = normal.view_mut((first, first), (size, size));
                block += precision;
                log_prior += log_determinant;
                first += size;
            }
        }
        let factor = Factor::new(&normal, 0.0)?;
        let coefficients = factor.solve(&right);
        let explained = right.dot(&coefficients);
        Some(Self {
            log_evidence: 0.5 * (explained - squares + log_prior - factor.log_determinant()),
            covariance: factor.inverse(),
            coefficients,
            constant,
            splines,
        })
    }

    /// R / r_scale and L / l_scale at a place, and their variances.
    pub fn at(&self, place: HalfCyclePoint) -> ([f64; OUTPUTS], [f64; OUTPUTS]) {
        let row = row(&self.splines, place);
        let functions = self.coefficients.len() / OUTPUTS;
        let value = |o: usize| {
            let added: f64 = row
                .iter()
                .map(|(k, x)| x * self.coefficients[o * functions + k])
                .sum();
            self.constant[o] * (1.0 + added)
        };
        let variance = |o: usize| {
            let mut sum = 0.0;
            for (k, x) in row {
                let column = self.covariance.column(o * functions + k);
                let along: f64 = row.iter().map(|(m, y)| y * column[o * functions + m]).sum();
                sum += x * along;
            }
            self.constant[o].powi(2) * f64::max(sum, 0.0)
        };
        (std::array::from_fn(value), std::array::from_fn(variance))
    }

    /// Returns `true` if the law's residuals at the slow times, relative to noise and to what the VI branch leaves, are too small for a
    /// network to find more.
    pub fn holds(residuals: &[f64]) -> bool {
        // The comparison is false for NaN.
        residuals.iter().sum::<f64>() <= MAX_RESIDUAL * residuals.len() as f64
    }
}

/// Position of a current on the law's axis.
fn axis(i_a: f64) -> f64 {
    (i_a / KNEE_A).ln_1p()
}

fn row(splines: &[CubicSpline; 2], place: HalfCyclePoint) -> Row {
    let [law, flanks] = splines;
    let z = axis(place.i_a);
    let (first, values) = law.values_at(z);
    let (after, others) = flanks.values_at(z);
    std::array::from_fn(|m| match m.checked_sub(4) {
        None => (first + m, values[m]),
        Some(m) => (law.functions() + after + m, others[m] * place.cosine),
    })
}
