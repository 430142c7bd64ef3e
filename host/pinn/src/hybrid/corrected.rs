//! R(t) and L(t) of the last pass: the RL-MLP with its correction, and the part of σ beside noise.

use ihd_spline::CubicSpline;
use ihd_spline::residual::Excess;
use nalgebra::Complex;

use super::pass::Pass;
use crate::correction::{Correction, Problem};
use crate::harmonic_branch::HarmonicBranch;
use crate::loss::{SlowPhysics, slow_times_s};
use crate::parameters::{OUTPUTS, Parameters};

/// Slow times on either side over which the residual of eq. (1) is averaged.
const REACH: usize = 6;

/// Trained network with its correction.
pub(super) struct CorrectedNetwork<'a> {
    pass: &'a Pass<'a>,
    network: &'a Parameters,
    correction: Option<Correction>,
    physics: SlowPhysics,
    excess: Excess,
    /// Mean square of one component of V − Z·I at each slow time, normalised.
    left: Vec<f64>,
    /// Variance of one component of the phasors' V − Z·I under white noise, normalised.
    variance: f64,
}

impl<'a> CorrectedNetwork<'a> {
    /// Creates the correction; `branch` is fitted to the data alone, because the fit of eq. (7) is biased towards the network.
    pub fn new(pass: &'a Pass<'a>, branch: &HarmonicBranch, network: &'a Parameters) -> Self {
        let (samples, config) = (pass.inputs.samples, pass.inputs.config);
        let times = slow_times_s(samples.duration_s(), config.slow_points);
        let laws = &pass.inputs.laws;
        let physics = SlowPhysics::condense(branch, samples, network, laws, config.w_f, times);
        let omega = samples.omega;
        let [r, l] = physics.best_constant();
        let (r, x) = (r * network.r_scale_ohm, l * network.l_scale_h * omega);
        let z = r.hypot(x);
        let at = |tau_s: &f64| {
            let (r, l) = network.r_l_at(samples.t0_s + tau_s);
            [r / network.r_scale_ohm, l / network.l_scale_h]
        };
        let outputs: Vec<_> = physics.tau_s.iter().map(at).collect();
        let residuals = physics.residuals(&outputs);
        let intervals = branch.basis.spline.functions().saturating_sub(3).max(1);
        // Uniform knots: each interval has enough slow times, also the first.
        let uniform = CubicSpline::new(intervals, samples.duration_s());
        let problem = Problem {
            physics: &physics,
            residuals: &residuals,
            spline: &uniform,
            noise: pass.noise,
            z: [z / network.r_scale_ohm, z / (omega * network.l_scale_h)],
        };
        let correction = config
            .correction
            .then(|| Correction::fit(&problem))
            .flatten();
        let z_squared = (z * samples.impedance_scale()).powi(2);
        let white = pass.white.0 + z_squared * pass.white.1;
        // One residual carries sqrt(w_f / 2K) of a component.
        let by_weight = 2.0 * physics.tau_s.len() as f64 / config.w_f;
        let floor = 1e-12 * physics.mean_square() * by_weight;
        let mut corrected = Self {
            pass,
            network,
            correction,
            excess: branch.excess(samples, pass.white),
            left: Vec::new(),
            physics,
            variance: 2.0 * white * intervals as f64 / samples.len() as f64 + floor,
        };
        corrected.left = (0..corrected.physics.tau_s.len())
            .map(|k| corrected.residual(&residuals, k) * by_weight)
            .collect();
        corrected
    }

    /// Mean square of both residuals of a slow time, after the correction.
    fn residual(&self, residuals: &[f64], k: usize) -> f64 {
        let physics = &self.physics;
        let added = self.added(physics.tau_s[k]).0;
        let square = |row: usize| {
            let by = physics.by_output(k, row);
            let e = residuals[row * physics.tau_s.len() + k];
            (e - by[0] * added[0] - by[1] * added[1]).powi(2)
        };
        0.5 * (square(0) + square(1))
    }

    /// Values that the correction adds to the outputs, and their variances.
    fn added(&self, tau_s: f64) -> ([f64; OUTPUTS], [f64; OUTPUTS]) {
        let at = |c: &Correction| c.at(tau_s);
        self.correction.as_ref().map_or(Default::default(), at)
    }

    /// R (ohm) and L (H) at `tau_s` seconds after the first point.
    pub fn r_l_at(&self, tau_s: f64) -> (f64, f64) {
        let (r, l) = self.network.r_l_at(self.pass.inputs.samples.t0_s + tau_s);
        let added = self.added(tau_s).0;
        (
            r + self.network.r_scale_ohm * added[0],
            l + self.network.l_scale_h * added[1],
        )
    }

    /// Raises the standard deviations of R (ohm) and L (H) by those of the correction and by the residual at the
    /// fundamental beyond noise; returns its χ².
    pub fn raise(&self, tau_s: f64, sigmas: [&mut f64; OUTPUTS]) -> f64 {
        let chi2 = self.chi2(tau_s);
        let variances = self.added(tau_s).1;
        let scales = [self.network.r_scale_ohm, self.network.l_scale_h];
        for (sigma, (variance, scale)) in sigmas.into_iter().zip(variances.iter().zip(scales)) {
            *sigma = ((*sigma * *sigma + variance * scale * scale) * chi2).sqrt();
        }
        chi2
    }

    fn chi2(&self, tau_s: f64) -> f64 {
        let count = self.left.len();
        let nearest = (tau_s / self.pass.inputs.samples.duration_s() * count as f64) as usize;
        let nearest = nearest.min(count - 1);
        let near = &self.left[nearest.saturating_sub(REACH)..(nearest + REACH + 1).min(count)];
        let beyond = near.iter().sum::<f64>() / near.len() as f64 - self.variance;
        let samples = &self.pass.inputs.samples;
        let (r_ohm, l_h) = self.r_l_at(tau_s);
        let z = Complex::new(r_ohm, samples.omega * l_h) * samples.impedance_scale();
        1.0 + (0.5 * self.excess.misfit(tau_s, z) + beyond.max(0.0)) / self.variance
    }
}
