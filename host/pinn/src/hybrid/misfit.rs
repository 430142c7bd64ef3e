//! Residual voltage of R(t) and L(t) at the fundamental, against white noise.

use ihd_spline::residual::Excess;
use nalgebra::Complex;

use crate::harmonic_branch::HarmonicBranch;
use crate::loss::SlowPhysics;
use crate::parameters::OUTPUTS;
use crate::waveform::NormalisedWaveform;

/// Slow times on either side over which the residual of eq. (1) is averaged.
const NEIGHBOUR_TIMES: usize = 6;

/// Residual along the window.
pub(super) struct Misfit<'a> {
    samples: &'a NormalisedWaveform,
    excess: Excess,
    /// Mean square of one component of V − Z·I at each slow time, normalised.
    left: Vec<f64>,
    /// Variance of one component of the phasors' V − Z·I under white noise, normalised.
    variance: f64,
}

impl<'a> Misfit<'a> {
    /// Computes the misfit of R and L, which are `outputs` at the slow times and `r_l` (ohm, H) on average. `branch` is fitted to the
    /// data alone, `white` are the variances of its noise, `w_f` is the weight of `physics`.
    pub fn new(
        samples: &'a NormalisedWaveform,
        (branch, white): (&HarmonicBranch, (f64, f64)),
        (physics, w_f): (&SlowPhysics, f64),
        outputs: &[[f64; OUTPUTS]],
        [r_ohm, l_h]: [f64; OUTPUTS],
    ) -> Self {
        let count = physics.tau_s.len();
        // One residual carries sqrt(w_f / 2K) of a component.
        let by_weight = 2.0 * count as f64 / w_f;
        let residuals = physics.residuals(outputs);
        let (on_r, on_l) = residuals.split_at(count);
        let squares = on_r.iter().zip(on_l).map(|(r, l)| 0.5 * (r * r + l * l));
        let z_squared = (r_ohm.hypot(samples.omega * l_h) * samples.impedance_scale()).powi(2);
        let noise = white.0 + z_squared * white.1;
        let intervals = branch.basis.spline.functions().saturating_sub(3).max(1);
        let floor = 1e-12 * physics.mean_square() * by_weight;
        Self {
            samples,
            excess: branch.excess(samples, white),
            left: squares.map(|square| square * by_weight).collect(),
            variance: 2.0 * noise * intervals as f64 / samples.len() as f64 + floor,
        }
    }

    /// χ² at `tau_s` seconds after the first point, where the load is R (ohm) and L (H).
    pub fn chi2(&self, tau_s: f64, r_l: (f64, f64)) -> f64 {
        self.chi2_of_branch(tau_s, r_l) + self.beyond(tau_s) / self.variance
    }

    /// Residual of eq. (1) at the same place relative to white noise and the VI branch's own residual, which no R and L change.
    pub fn share_of_load(&self, tau_s: f64, r_l: (f64, f64)) -> f64 {
        self.beyond(tau_s) / (self.variance * self.chi2_of_branch(tau_s, r_l))
    }

    /// χ² of the VI branch alone.
    fn chi2_of_branch(&self, tau_s: f64, (r_ohm, l_h): (f64, f64)) -> f64 {
        let z = Complex::new(r_ohm, self.samples.omega * l_h) * self.samples.impedance_scale();
        1.0 + 0.5 * self.excess.misfit(tau_s, z) / self.variance
    }

    /// Mean square of V − Z·I beyond noise, normalised.
    fn beyond(&self, tau_s: f64) -> f64 {
        let count = self.left.len();
        let nearest = (tau_s / self.samples.duration_s() * count as f64) as usize;
        let nearest = nearest.min(count - 1);
        let near = &self.left
            [nearest.saturating_sub(NEIGHBOUR_TIMES)..(nearest + NEIGHBOUR_TIMES + 1).min(count)];
        (near.iter().sum::<f64>() / near.len() as f64 - self.variance).max(0.0)
    }
}
