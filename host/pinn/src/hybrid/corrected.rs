//! R(t) and L(t) of the last pass: the RL-MLP with its correction, and the part of σ beside noise.

use ihd_spline::CubicSpline;

use super::misfit::Misfit;
use super::pass::Pass;
use crate::correction::{Correction, Problem};
use crate::harmonic_branch::HarmonicBranch;
use crate::loss::{SlowPhysics, slow_times_s};
use crate::parameters::{OUTPUTS, Parameters};

/// Trained network with its correction.
pub(super) struct CorrectedNetwork<'a> {
    pass: &'a Pass<'a>,
    network: &'a Parameters,
    correction: Option<Correction>,
    misfit: Misfit<'a>,
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
        let sum = |(tau_s, [r, l]): (&f64, &[f64; OUTPUTS])| {
            let [more_r, more_l] = added(&correction, *tau_s).0;
            [r + more_r, l + more_l]
        };
        let corrected: Vec<_> = physics.tau_s.iter().zip(&outputs).map(sum).collect();
        let typical = [r, x / omega];
        Self {
            misfit: Misfit::new(
                samples,
                (branch, pass.white),
                (&physics, config.w_f),
                &corrected,
                typical,
            ),
            pass,
            network,
            correction,
        }
    }

    /// R (ohm) and L (H) at `tau_s` seconds after the first point.
    pub fn r_l_at(&self, tau_s: f64) -> (f64, f64) {
        let (r, l) = self.network.r_l_at(self.pass.inputs.samples.t0_s + tau_s);
        let added = added(&self.correction, tau_s).0;
        (
            r + self.network.r_scale_ohm * added[0],
            l + self.network.l_scale_h * added[1],
        )
    }

    /// Raises the standard deviations of R (ohm) and L (H), which are `r_l` at this time, by those of the correction and by the
    /// residual at the fundamental beyond noise; returns its χ².
    pub fn raise(&self, tau_s: f64, r_l: (f64, f64), sigmas: [&mut f64; OUTPUTS]) -> f64 {
        let chi2 = self.misfit.chi2(tau_s, r_l);
        let variances = added(&self.correction, tau_s).1;
        let scales = [self.network.r_scale_ohm, self.network.l_scale_h];
        for (sigma, (variance, scale)) in sigmas.into_iter().zip(variances.iter().zip(scales)) {
            *sigma = ((*sigma * *sigma + variance * scale * scale) * chi2).sqrt();
        }
        chi2
    }
}

/// Values that a correction adds to the outputs, and their variances.
fn added(correction: &Option<Correction>, tau_s: f64) -> ([f64; OUTPUTS], [f64; OUTPUTS]) {
    let at = |c: &Correction| c.at(tau_s);
    correction.as_ref().map_or(Default::default(), at)
}
