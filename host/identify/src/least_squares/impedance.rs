//! R(t) and ωL(t) as rational splines through the fundamental's phasors: V = R·I + ωL·(jI + I'/ω).
//!
//! A Gaussian prior on the second differences of the coefficients keeps noise from bending R and L. Its weight against the data
//! follows from the noise measured in the capture, and is zero without noise. R and L are functions of the current's amplitude
//! with their largest slopes at small currents, so that the expected bend grows as the current falls. The posterior's
//! covariance gives the error bars.

use std::f64::consts::TAU;

use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use ihd_spline::CubicSpline;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::phasors::SplineFit;
use super::rational::RationalSpline;
use super::{LeastSquaresSettings, intervals};
use crate::model_residual::ModelResidual;
use crate::{Estimate, IdentifyError, Method};

/// Phasors that are used per interval of R and L.
const PER_INTERVAL: usize = 4;

/// Least assumed relative noise: the residual of the phasors' splines.
const NOISE_FLOOR: f64 = 1e-6;

/// Largest mean square of the bends of a load, in units of the expected ones (the loads of the simulator from 45 kHz: 13).
const MAX_RIPPLE: f64 = 40.0;

/// Bends on either side that are averaged: more than two periods of the fastest change that the splines follow.
const RIPPLE_REACH: usize = 4;

/// Largest expected bend, as a share of the impedance.
const MAX_BEND: f64 = 0.3;

/// Appends R and L of a stretch, one value per switching period.
pub fn fit(
    segment: &Segment,
    phasors: &SplineFit,
    settings: &LeastSquaresSettings,
    noise: WhiteNoise,
    estimate: &mut Estimate,
    residual: &mut ModelResidual,
) -> Result<(), IdentifyError> {
    let omega = TAU * segment.f_sw_hz;
    let duration_s = phasors.duration_s;
    let count = intervals(settings.impedance_intervals, duration_s, segment);
    let grid = Grid::new(phasors, PER_INTERVAL * count, noise);
    let spline = RationalSpline::new(
        CubicSpline::new(count, duration_s),
        |tau_s| phasors.at(tau_s).i.norm(),
        grid.i_square_max.sqrt(),
    );
    let mut problem = Problem::new(&spline);
    grid.add_rows(&mut problem, &spline, omega);
    let bends = grid.bends(spline.functions(), settings.bend);
    for (k, bend) in bends.iter().enumerate() {
        problem.add_bend(k + 1, 1.0 / (bend * bend));
    }
    let solution = problem.solve()?;
    let ripple = solution.ripple(&bends);
    let residuals: Vec<f64> = (0..grid.points)
        .map(|k| solution.residual(&spline, phasors, grid.tau_s(k), omega))
        .collect();
    let periods = (duration_s * segment.f_sw_hz).floor().max(1.0) as usize;
    for k in 0..periods {
        let tau_s = (k as f64 + 0.5) / segment.f_sw_hz;
        let (found, sigma) = solution.at(&spline, tau_s);
        let z = nalgebra::Complex::new(found[0], found[1]);
        let misfit = phasors.excess.misfit(tau_s, z);
        let beyond = grid.mean_near(&residuals, tau_s) - grid.variance;
        let chi2 = 1.0 + (0.5 * misfit + beyond.max(0.0)) / grid.variance;
        let chi2 = chi2.max(ripple.chi2_at(tau_s / duration_s));
        let ripple = ripple.square_at(tau_s / duration_s);
        let square = phasors.at(tau_s).i.norm_sqr();
        // Half of an aliased harmonic is in phase with the current.
        let least = 1e-9 * grid.i_square_max;
        let aliased = 0.5 * phasors.aliased_v(tau_s).powi(2) / square.max(least);
        let sigma = sigma.map(|s| (s * s * chi2 + ripple + aliased).sqrt());
        let relative = [sigma[0] / found[0], sigma[1] / found[1]];
        residual.add(square, chi2, relative);
        let t_s = phasors.t0_s + tau_s;
        estimate.push(
            t_s,
            (found[0], found[1] / omega),
            (sigma[0], sigma[1] / omega),
        );
    }
    Ok(())
}

/// Evenly spaced points of a stretch at which the load is fitted.
struct Grid<'a> {
    phasors: &'a SplineFit,
    points: usize,
    /// Largest square of the current's amplitude, in A².
    i_square_max: f64,
    /// Square of the stretch's impedance, in Ω².
    z_square: f64,
    /// Variance of one component of V − Z·I in V², shared by the points of an interval of the phasors.
    variance: f64,
}

impl<'a> Grid<'a> {
    fn new(phasors: &'a SplineFit, points: usize, noise: WhiteNoise) -> Self {
        let mut grid = Self {
            phasors,
            points,
            i_square_max: 0.0,
            z_square: 0.0,
            variance: 0.0,
        };
        let (mut v_energy, mut i_energy) = (0.0, 0.0);
        for k in 0..points {
            let p = phasors.at(grid.tau_s(k));
            v_energy += p.v.norm_sqr();
            i_energy += p.i.norm_sqr();
            grid.i_square_max = grid.i_square_max.max(p.i.norm_sqr());
        }
        grid.z_square = v_energy / i_energy;
        let floor = NOISE_FLOOR * NOISE_FLOOR * v_energy / points as f64;
        let white = noise.v_v * noise.v_v + grid.z_square * noise.i_a * noise.i_a;
        grid.variance = 2.0 * white / phasors.samples_per_interval + floor;
        grid
    }

    /// Time of point `k` in seconds since the beginning of the stretch.
    fn tau_s(&self, k: usize) -> f64 {
        (k as f64 + 0.5) / self.points as f64 * self.phasors.duration_s
    }

    /// Points that share the samples of an interval of the phasors. It may have fewer than [`PER_INTERVAL`], where phasors are to follow
    /// more than R and L; one point holds the samples of one interval at most.
    fn sharing(&self) -> f64 {
        (self.points as f64 / self.phasors.intervals as f64).max(1.0)
    }

    /// Adds the equations V = Z·I of all points, together with the information of all samples.
    fn add_rows(&self, problem: &mut Problem, spline: &RationalSpline, omega: f64) {
        let weight = 1.0 / (self.variance * self.sharing());
        for tau_s in (0..self.points).map(|k| self.tau_s(k)) {
            let (p, local) = (self.phasors.at(tau_s), spline.at(tau_s));
            let d = nalgebra::Complex::new(0.0, 1.0) * p.i + p.i_slope / omega;
            for (v, i, d) in [(p.v.re, p.i.re, d.re), (p.v.im, p.i.im, d.im)] {
                problem.add_row(weight, local.first, &local.values, (i, d), v);
            }
        }
    }

    /// Expected bends in ohm of a spline of so many functions; `share` is that of the impedance at the largest current.
    fn bends(&self, functions: usize, share: f64) -> Vec<f64> {
        let bend = |j: usize| {
            let place = (j as f64 - 1.0) / (functions as f64 - 3.0).max(1.0);
            let square = self
                .phasors
                .at(place * self.phasors.duration_s)
                .i
                .norm_sqr();
            let times = (self.i_square_max / square.max(1e-9 * self.i_square_max)).powf(0.75);
            (share * times).min(MAX_BEND) * self.z_square.sqrt()
        };
        (1..functions.saturating_sub(1)).map(bend).collect()
    }

    /// Mean of values of the points over an interval to either side of a time in seconds.
    fn mean_near(&self, values: &[f64], tau_s: f64) -> f64 {
        let nearest = tau_s / self.phasors.duration_s * self.points as f64;
        let nearest = (nearest as usize).min(self.points - 1);
        let until = (nearest + PER_INTERVAL + 1).min(self.points);
        let near = &values[nearest.saturating_sub(PER_INTERVAL)..until];
        near.iter().sum::<f64>() / near.len() as f64
    }
}

/// Bends of R and ωL that no load has: more than [`MAX_RIPPLE`] times the expected ones over [`RIPPLE_REACH`].
struct Ripple {
    /// Mean square of the expected bends, and of the excess of the measured ones, in Ω²; one pair per function of the
    /// spline.
    squares: Vec<[f64; 2]>,
}

impl Ripple {
    fn near(&self, share: f64) -> [f64; 2] {
        let last = self.squares.len().saturating_sub(1);
        let place = (share * self.squares.len() as f64) as usize;
        self.squares
            .get(place.min(last))
            .copied()
            .unwrap_or([1.0, 0.0])
    }

    /// Variance of R and ωL in Ω² at a share of the stretch.
    fn square_at(&self, share: f64) -> f64 {
        self.near(share)[1]
    }

    /// Squared bends over the expected ones if they exceed those of a load, else 0.
    fn chi2_at(&self, share: f64) -> f64 {
        let [expected, beyond] = self.near(share);
        beyond / expected
    }
}

/// Normal equations of the coefficients, R and ωL alternating.
struct Problem {
    a: DMatrix<f64>,
    b: DVector<f64>,
}

struct Solution {
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Problem {
    fn new(spline: &RationalSpline) -> Self {
        let size = 2 * spline.functions();
        Self {
            a: DMatrix::zeros(size, size),
            b: DVector::zeros(size),
        }
    }

    /// Adds weight·(v − R·i − X·d)².
    fn add_row(
        &mut self,
        weight: f64,
        first: usize,
        values: &[f64; 4],
        (i, d): (f64, f64),
        v: f64,
    ) {
        let row: [f64; 8] = std::array::from_fn(|m| values[m / 2] * if m % 2 == 0 { i } else { d });
        for (m, x) in row.iter().enumerate() {
            self.b[2 * first + m] += weight * x * v;
            for (n, y) in row.iter().enumerate() {
                self.a[(2 * first + m, 2 * first + n)] += weight * x * y;
            }
        }
    }

    /// Adds weight·(c[j−1] − 2c[j] + c[j+1])² for R and for ωL.
    fn add_bend(&mut self, j: usize, weight: f64) {
        const STENCIL: [f64; 3] = [1.0, -2.0, 1.0];
        for quantity in 0..2 {
            for (m, x) in STENCIL.iter().enumerate() {
                for (n, y) in STENCIL.iter().enumerate() {
                    let (r, c) = (2 * (j + m - 1) + quantity, 2 * (j + n - 1) + quantity);
                    self.a[(r, c)] += weight * x * y;
                }
            }
        }
    }

    fn solve(self) -> Result<Solution, IdentifyError> {
        let factor: Cholesky<f64, Dyn> =
            Cholesky::new(self.a).ok_or_else(|| IdentifyError::Unfit {
                method: Method::LeastSquares,
                why: "R and L cannot be told apart: there is too little current".into(),
            })?;
        Ok(Solution {
            coefficients: factor.solve(&self.b),
            covariance: factor.inverse(),
        })
    }
}

impl Solution {
    /// Second differences of the coefficients relative to the expected ones, `bends` in ohm.
    fn ripple(&self, bends: &[f64]) -> Ripple {
        let c = |j: usize, quantity: usize| self.coefficients[2 * j + quantity];
        let square = |(k, bend): (usize, &f64)| {
            let of = |q| (c(k, q) - 2.0 * c(k + 1, q) + c(k + 2, q)) / bend;
            0.5 * (of(0) * of(0) + of(1) * of(1))
        };
        let squares: Vec<f64> = bends.iter().enumerate().map(square).collect();
        let near = |k: usize| {
            let near =
                &squares[k.saturating_sub(RIPPLE_REACH)..(k + RIPPLE_REACH + 1).min(squares.len())];
            let expected = bends[k] * bends[k];
            let mean = near.iter().sum::<f64>() / near.len() as f64;
            [
                expected,
                if mean > MAX_RIPPLE {
                    mean * expected
                } else {
                    0.0
                },
            ]
        };
        Ripple {
            squares: (0..bends.len()).map(near).collect(),
        }
    }

    /// Mean square of one component of V − R·I − ωL·(jI + I'/ω) at a time, in V².
    fn residual(
        &self,
        spline: &RationalSpline,
        phasors: &SplineFit,
        tau_s: f64,
        omega: f64,
    ) -> f64 {
        let (p, ([r, x], _)) = (phasors.at(tau_s), self.at(spline, tau_s));
        let d = nalgebra::Complex::new(0.0, 1.0) * p.i + p.i_slope / omega;
        0.5 * (p.v - p.i * r - d * x).norm_sqr()
    }

    /// R and ωL in ohm at a time, and their standard deviations.
    fn at(&self, spline: &RationalSpline, tau_s: f64) -> ([f64; 2], [f64; 2]) {
        let local = spline.at(tau_s);
        let index = |m: usize, quantity: usize| 2 * (local.first + m) + quantity;
        let value = |quantity: usize| {
            (0..4)
                .map(|m| local.values[m] * self.coefficients[index(m, quantity)])
                .sum()
        };
        let sigma = |quantity: usize| {
            let mut sum = 0.0;
            for (m, x) in local.values.iter().enumerate() {
                for (n, y) in local.values.iter().enumerate() {
                    sum += x * y * self.covariance[(index(m, quantity), index(n, quantity))];
                }
            }
            sum.max(0.0).sqrt()
        };
        ([value(0), value(1)], [sigma(0), sigma(1)])
    }
}
