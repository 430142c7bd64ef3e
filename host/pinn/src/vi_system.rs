//! Linear least squares for the VI branch. It minimises w_i (L_i1 + L_i2), the paper's eqs. (5), (6), or, with R and L
//! given, all of eq. (7) with w_f L_f of eq. (4). All three terms are quadratic in the coefficients.

use std::f64::consts::TAU;

use ihd_spline::Banded;
use ihd_spline::harmonic::{HarmonicFit, NormalEquations};

use crate::PinnError;
use crate::harmonic_branch::{HarmonicBasis, HarmonicBranch};
use crate::impedance_law::HarmonicLaw;
use crate::waveform::NormalisedWaveform;

/// R and L at one slow time, normalised by the waveform's maxima.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Impedance {
    /// Time after the first pair, s.
    pub tau_s: f64,
    /// R i_max / v_max.
    pub r: f64,
    /// L i_max / v_max, s.
    pub l: f64,
}

/// Contribution of the physics term to the normal equations of the VI branch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PhysicsTerm<'a> {
    /// w_f / w_i.
    pub weight: f64,
    /// R and L on the slow collocation grid.
    pub impedance: &'a [Impedance],
    /// Impedance law at each harmonic that the term covers.
    pub harmonics: &'a [HarmonicLaw],
}

/// Normal equations of the data terms. Voltage and current share the matrix, because times and functions are the
/// same.
#[derive(Debug, Clone)]
pub(crate) struct DataSystem {
    basis: HarmonicBasis,
    sums: NormalEquations,
    /// Mean squares of voltage and current.
    squares: (f64, f64),
}

impl DataSystem {
    /// Sums the normal equations over all points; each entry is a mean, like eqs. (5) and (6).
    pub fn assemble(samples: &NormalisedWaveform, basis: HarmonicBasis) -> Self {
        let fit = HarmonicFit {
            spline: &basis.spline,
            orders: &basis.harmonics,
            gains: &basis.gains,
            periods_per_sample: basis.omega * samples.dt_s / TAU,
            dt_s: samples.dt_s,
            block: 1,
            centre: 0.0,
        };
        let mut sums = fit.normal_equations(&samples.v, &samples.i);
        let share = 1.0 / samples.len() as f64;
        sums.gram.scale(share);
        for x in [&mut sums.v, &mut sums.i] {
            x.iter_mut().for_each(|x| *x *= share);
        }
        let square = |x: &[f64]| share * x.iter().map(|x| x * x).sum::<f64>();
        let squares = (square(&samples.v), square(&samples.i));
        Self {
            basis,
            sums,
            squares,
        }
    }

    /// Mean squared errors of v_hat and i_hat over the points: L_i1 and L_i2, eqs. (5) and (6). |Ax − y|² is multiplied
    /// out, which is exact to 1e-16 of the mean square of the points; 12 bit are 1e-8 of it.
    pub fn losses(&self, branch: &HarmonicBranch) -> (f64, f64) {
        let loss = |x: &[f64], right: &[f64], square: f64| {
            let across: f64 = x.iter().zip(right).map(|(x, b)| x * b).sum();
            f64::max(
                self.sums.gram.quadratic_form(x) - 2.0 * across + square,
                0.0,
            )
        };
        (
            loss(&branch.v, &self.sums.v, self.squares.0),
            loss(&branch.i, &self.sums.i, self.squares.1),
        )
    }

    /// Minimises the data terms alone.
    pub fn fit(&self) -> Result<HarmonicBranch, PinnError> {
        let [v, i] = self.sums.clone().solve()?;
        Ok(HarmonicBranch {
            basis: self.basis.clone(),
            v,
            i,
        })
    }

    /// Minimises the whole loss (7) over the VI branch, with R(t) and L(t) held.
    pub fn fit_with_physics(&self, physics: &PhysicsTerm<'_>) -> Result<HarmonicBranch, PinnError> {
        let mut joint = self.doubled();
        self.add_physics(&mut joint, physics);
        let (width, functions) = (self.basis.width(), self.basis.spline.functions());
        let mut x = vec![0.0; 2 * self.basis.len()];
        for j in 0..functions {
            let (from, to) = (j * width, 2 * j * width);
            x[to..to + width].copy_from_slice(&self.sums.v[from..from + width]);
            x[to + width..to + 2 * width].copy_from_slice(&self.sums.i[from..from + width]);
        }
        let mut solved = [x];
        joint.solve(&mut solved)?;
        let blocks = |offset: usize| {
            (0..functions)
                .flat_map(|j| (0..width).map(move |k| 2 * j * width + offset + k))
                .map(|at| solved[0][at])
                .collect()
        };
        Ok(HarmonicBranch {
            basis: self.basis.clone(),
            v: blocks(0),
            i: blocks(width),
        })
    }

    /// The data terms of v and i in one matrix; per spline function first v, then i, so that the
    /// band stays narrow.
    fn doubled(&self) -> Banded {
        let width = self.basis.width();
        let mut joint = Banded::zeros(2 * self.basis.len(), 8 * width - 1);
        for row in 0..self.basis.len() {
            let place = |at: usize| 2 * (at / width) * width + at % width;
            for column in row.saturating_sub(4 * width - 1)..=row {
                let value = self.sums.gram.get(row, column);
                joint.add(place(row), place(column), value);
                joint.add(place(row) + width, place(column) + width, value);
            }
        }
        joint
    }

    /// Adds the squared real and imaginary parts of `V - Z I - (dZ/ds) I'` at each slow time.
    fn add_physics(&self, joint: &mut Banded, physics: &PhysicsTerm<'_>) {
        let width = self.basis.width();
        // Half: Parseval, see `loss`.
        let share = 0.5 * physics.weight / physics.impedance.len() as f64;
        for z in physics.impedance {
            let local = self.basis.spline.at(z.tau_s);
            for law in physics.harmonics {
                let (impedance, slope) = law.impedance(z.r, z.l);
                let mut in_phase = Vec::with_capacity(12);
                let mut quadrature = Vec::with_capacity(12);
                for m in 0..4 {
                    let v = 2 * (local.first + m) * width + 2 * law.index;
                    let i = v + width;
                    let b = local.values[m];
                    let g = impedance * b + slope * local.slopes_per_s[m];
                    in_phase.extend([(v, b), (i, -g.re), (i + 1, -g.im)]);
                    quadrature.extend([(v + 1, b), (i, g.im), (i + 1, -g.re)]);
                }
                add_square(joint, share, &in_phase);
                add_square(joint, share, &quadrature);
            }
        }
    }
}

/// Adds `weight * row^T row` for a sparse row.
fn add_square(matrix: &mut Banded, weight: f64, row: &[(usize, f64)]) {
    for &(r, a) in row {
        for &(c, b) in row.iter().filter(|(c, _)| *c <= r) {
            matrix.add(r, c, weight * a * b);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Complex;

    use super::*;
    use crate::loss::slow_times_s;
    use crate::trial;

    /// L_f by Parseval, eq. (4), for a constant normalised impedance.
    fn l_f(branch: &HarmonicBranch, laws: &[HarmonicLaw], impedance: &[Impedance]) -> f64 {
        let sum: f64 = impedance
            .iter()
            .flat_map(|z| laws.iter().map(move |law| (law, z)))
            .map(|(law, z)| (law, z, branch.phasors(z.tau_s, law.index)))
            .map(|(law, z, at)| {
                let (impedance, slope) = law.impedance(z.r, z.l);
                0.5 * (at.v - impedance * at.i - slope * at.slope).norm_sqr()
            })
            .sum();
        sum / impedance.len() as f64
    }

    #[test]
    fn a_smooth_window_is_reproduced_to_the_last_code() {
        let samples = trial::samples();
        let branch = trial::fitted(&samples);
        let (l_i1, l_i2) = branch.data_losses(&samples);
        assert!(l_i1 < 1e-9 && l_i2 < 1e-9, "{l_i1} {l_i2}");
    }

    #[test]
    fn losses_of_the_normal_equations_are_those_of_the_points() {
        let samples = trial::samples();
        let system = DataSystem::assemble(&samples, trial::basis(&samples));
        let fitted = system.fit().expect("separable");
        let mut off = fitted.clone();
        off.v[11] += 1e-3;
        off.i[30] -= 0.2;
        for branch in [fitted, off] {
            let (found, right) = (system.losses(&branch), branch.data_losses(&samples));
            assert!((found.0 - right.0).abs() < 1e-14 && (found.1 - right.1).abs() < 1e-14);
        }
    }

    #[test]
    fn means_of_blocks_lead_to_the_same_phasors_and_to_the_samples_in_their_middle() {
        let raw = trial::samples_at(5e6);
        // Fives would leave the third harmonic seven points a period: fours are taken.
        let points = raw.clone().averaged(10_000, 3);
        assert_eq!((points.block, points.len()), (4, 12_500));
        let (whole, averaged) = (trial::fitted(&raw), trial::fitted(&points));
        // Without its gain the third harmonic would be off by 1 - sinc = 2e-2.
        assert!((points.gain(3) - 0.98).abs() < 5e-3 && raw.gain(3) == 1.0);
        let later_s = points.t0_s - raw.t0_s;
        for tau_s in [0.4e-3, 2.1e-3, 5e-3, 9.3e-3] {
            for (index, h) in [1.0, 3.0].into_iter().enumerate() {
                let turn = Complex::from_polar(1.0, h * raw.omega * later_s);
                let a = whole.phasors(tau_s + later_s, index).i * turn;
                let b = averaged.phasors(tau_s, index).i;
                assert!((a - b).norm() < 1e-5, "{h}: {a} and {b}");
            }
        }
        let fitted = averaged.signals(&points, points.len());
        for (n, i) in fitted.sample.iter().zip(&fitted.i) {
            assert!((i - raw.i[*n]).abs() < 1e-4);
        }
        let (l_i1, l_i2) = averaged.data_losses(&points);
        assert!(l_i1 < 1e-9 && l_i2 < 1e-9, "{l_i1} {l_i2}");
    }

    #[test]
    fn the_joint_fit_is_a_minimum_of_the_whole_loss() {
        let samples = trial::samples();
        let system = DataSystem::assemble(&samples, trial::basis(&samples));
        // A wrong load: physics and data pull apart, so neither term alone is at its minimum.
        let scale = samples.impedance_scale();
        let impedance: Vec<Impedance> = slow_times_s(samples.duration_s(), 64)
            .into_iter()
            .map(|tau_s| Impedance {
                tau_s,
                r: 4.4 * scale,
                l: 21e-6 * scale,
            })
            .collect();
        let weight = 5.0;
        for order in [0.0, 0.5] {
            let laws = trial::laws(order, &system.basis, &[0, 1]);
            let total = |branch: &HarmonicBranch| {
                let (l_i1, l_i2) = branch.data_losses(&samples);
                weight * l_f(branch, &laws, &impedance) + l_i1 + l_i2
            };
            let joint = system
                .fit_with_physics(&PhysicsTerm {
                    weight,
                    impedance: &impedance,
                    harmonics: &laws,
                })
                .expect("positive definite");
            let lowest = total(&joint);
            assert!(lowest < 0.9 * total(&system.fit().expect("separable")));
            for (at, step) in [(0, 1e-3), (17, -1e-3), (30, 1e-3), (41, -1e-3)] {
                let (mut on_v, mut on_i) = (joint.clone(), joint.clone());
                on_v.v[at] += step;
                on_i.i[at] += step;
                assert!(total(&on_v) > lowest && total(&on_i) > lowest);
            }
        }
    }
}
