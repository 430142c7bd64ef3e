//! The physics term, eq. (4), in the rotating frame.
//!
//! The residual is a sum of harmonics, `r(t) = sum_h Re{ r_h exp(j h w t) }` with
//! `r_h = V_h - R I_h - L (I_h' + j h w I_h)`, or that of another [`crate::ImpedanceOrder`]. R, L
//! and the phasors hardly change within a switching period, so that by Parseval the mean of r^2 over a
//! period is `1/2 sum_h |r_h|^2`, and the mean over the window, eq. (4), is the mean of that at a few
//! hundred slow times. The difference from the sum over all samples is of order (envelope slope / w)^2.
//!
//! `r_h` is linear in R and L. At each slow time the rows of all harmonics therefore condense, by a QR
//! factorisation of two columns, into two: `e = d - C (R / r_scale, L / l_scale)`, C triangular.

use burn::tensor::{Device, Tensor};
use nalgebra::Complex;

use crate::PinnError;
use crate::backend::Backend;
use crate::harmonic_branch::HarmonicBranch;
use crate::impedance_law::HarmonicLaw;
use crate::levenberg_marquardt::Evaluation;
use crate::parameters::{OUTPUTS, Parameters};
use crate::rl_mlp::{RlMlp, matrix, read};
use crate::waveform::NormalisedWaveform;

/// `w_f L_f` as a function of the RL-MLP: the sum of squares of `e`, plus a floor that the network
/// cannot change.
#[derive(Debug, Clone)]
pub(crate) struct SlowPhysics {
    /// Times after the first pair, s.
    pub tau_s: Vec<f64>,
    c_rr: Vec<f64>,
    c_rl: Vec<f64>,
    c_ll: Vec<f64>,
    d_r: Vec<f64>,
    d_l: Vec<f64>,
    /// The part of `w_f L_f` that is orthogonal to R and L.
    pub floor: f64,
}

/// Midpoints of `count` equal parts of the window: a midpoint rule for the mean in eq. (4).
pub(crate) fn slow_times_s(duration_s: f64, count: usize) -> Vec<f64> {
    (0..count)
        .map(|k| (k as f64 + 0.5) / count as f64 * duration_s)
        .collect()
}

impl SlowPhysics {
    /// Condenses the physics term for the phasors of `branch`.
    ///
    /// The scales are those of `parameters`.
    pub fn condense(
        branch: &HarmonicBranch,
        samples: &NormalisedWaveform,
        parameters: &Parameters,
        harmonics: &[HarmonicLaw],
        w_f: f64,
        tau_s: Vec<f64>,
    ) -> Self {
        let weight = (0.5 * w_f / tau_s.len() as f64).sqrt();
        let to_r = parameters.r_scale_ohm * samples.impedance_scale() * weight;
        let to_l = parameters.l_scale_h * samples.impedance_scale() * weight;
        let mut physics = Self {
            c_rr: Vec::with_capacity(tau_s.len()),
            c_rl: Vec::with_capacity(tau_s.len()),
            c_ll: Vec::with_capacity(tau_s.len()),
            d_r: Vec::with_capacity(tau_s.len()),
            d_l: Vec::with_capacity(tau_s.len()),
            floor: 0.0,
            tau_s: Vec::new(),
        };
        for &tau in &tau_s {
            let mut columns = [Vec::new(), Vec::new(), Vec::new()];
            for law in harmonics {
                let at = branch.phasors(tau, law.index);
                let (by_r, by_l) = law.columns(&at);
                let parts = |z: Complex<f64>, factor: f64| [factor * z.re, factor * z.im];
                columns[0].extend(parts(by_r, to_r));
                columns[1].extend(parts(by_l, to_l));
                columns[2].extend(parts(at.v, weight));
            }
            physics.push(columns);
        }
        physics.tau_s = tau_s;
        physics
    }

    /// Gram-Schmidt on (R column, L column), applied to the voltage column as well.
    fn push(&mut self, [mut on_r, mut on_l, mut v]: [Vec<f64>; 3]) {
        let c_rr = normalise(&mut on_r);
        let c_rl = project_out(&on_r, &mut on_l);
        let c_ll = normalise(&mut on_l);
        self.c_rr.push(c_rr);
        self.c_rl.push(c_rl);
        self.c_ll.push(c_ll);
        self.d_r.push(project_out(&on_r, &mut v));
        self.d_l.push(project_out(&on_l, &mut v));
        self.floor += v.iter().map(|x| x * x).sum::<f64>();
    }

    /// The constant (R / r_scale, L / l_scale) that fits best: a start for the network.
    pub fn best_constant(&self) -> [f64; OUTPUTS] {
        let [rr, rl, ll] = self.normal();
        let r = dot(&self.c_rr, &self.d_r);
        let l = dot(&self.c_rl, &self.d_r) + dot(&self.c_ll, &self.d_l);
        let determinant = rr * ll - rl * rl;
        let constant = [
            (ll * r - rl * l) / determinant,
            (rr * l - rl * r) / determinant,
        ];
        // The scales themselves are the start if the window gives no sensible constant.
        constant.map(|y| if y.is_finite() { y.max(1e-3) } else { 1.0 })
    }

    /// Relative standard deviation of the best constant, the larger of R's and L's, with `noise` the
    /// variance of one residual; the lower limit for any R(t), L(t).
    pub fn relative_sigma(&self, constant: [f64; OUTPUTS], noise: f64) -> f64 {
        let [rr, rl, ll] = self.normal();
        let determinant = rr * ll - rl * rl;
        let [r, l] = [ll / constant[0].powi(2), rr / constant[1].powi(2)];
        (noise * r.max(l) / determinant).sqrt()
    }

    /// Entries RR, RL and LL of the normal matrix for a constant load.
    fn normal(&self) -> [f64; 3] {
        [
            dot(&self.c_rr, &self.c_rr),
            dot(&self.c_rr, &self.c_rl),
            dot(&self.c_rl, &self.c_rl) + dot(&self.c_ll, &self.c_ll),
        ]
    }

    /// Minus the derivatives of a slow time's residual, R's (0) or L's, by R / r_scale and L / l_scale.
    pub fn by_output(&self, k: usize, row: usize) -> [f64; OUTPUTS] {
        match row {
            0 => [self.c_rr[k], self.c_rl[k]],
            _ => [0.0, self.c_ll[k]],
        }
    }

    /// Mean square of one component of the voltage, in units of the residuals.
    pub fn mean_square(&self) -> f64 {
        (dot(&self.d_r, &self.d_r) + dot(&self.d_l, &self.d_l)) / (2 * self.tau_s.len()) as f64
    }

    /// The residuals e for the outputs (R / r_scale, L / l_scale) at each slow time: first the R
    /// rows of all slow times, then the L rows.
    pub fn residuals(&self, outputs: &[[f64; OUTPUTS]]) -> Vec<f64> {
        let on_r = outputs
            .iter()
            .enumerate()
            .map(|(k, [r, l])| self.d_r[k] - self.c_rr[k] * r - self.c_rl[k] * l);
        let on_l = outputs
            .iter()
            .enumerate()
            .map(|(k, [_, l])| self.d_l[k] - self.c_ll[k] * l);
        on_r.chain(on_l).collect()
    }

    /// Derivatives of the residuals by R / r_scale and L / l_scale at each slow time: of the R rows, then of the L rows.
    pub fn factors(&self) -> [[Vec<f64>; OUTPUTS]; OUTPUTS] {
        let less = |c: &[f64]| c.iter().map(|c| -c).collect();
        [
            [less(&self.c_rr), less(&self.c_rl)],
            [vec![0.0; self.tau_s.len()], less(&self.c_ll)],
        ]
    }

    /// Physics term on a burn device, with the RL-MLP's features.
    pub fn on_device(
        &self,
        samples: &NormalisedWaveform,
        parameters: &Parameters,
        backend: Backend,
        device: &Device,
    ) -> SlowTensors {
        let count = self.tau_s.len();
        let features = self
            .tau_s
            .iter()
            .flat_map(|tau| parameters.features(samples.t0_s + tau))
            .collect();
        let column = |values: &[f64]| matrix(values.to_vec(), [count, 1], device);
        SlowTensors {
            features: matrix(features, [count, parameters.width()], device),
            c_rr: column(&self.c_rr),
            c_rl: column(&self.c_rl),
            c_ll: column(&self.c_ll),
            d_r: column(&self.d_r),
            d_l: column(&self.d_l),
            backend,
            device: device.clone(),
        }
    }
}

/// [`SlowPhysics`] as tensors: one row per slow time.
#[derive(Debug, Clone)]
pub(crate) struct SlowTensors {
    pub features: Tensor<2>,
    pub c_rr: Tensor<2>,
    pub c_rl: Tensor<2>,
    pub c_ll: Tensor<2>,
    d_r: Tensor<2>,
    d_l: Tensor<2>,
    pub backend: Backend,
    pub device: Device,
}

impl SlowTensors {
    /// The residuals e: first the R rows of all slow times, then the L rows.
    pub fn residuals(&self, network: &RlMlp) -> Tensor<2> {
        let y = network.forward(self.features.clone());
        let (r, l) = (y.clone().narrow(1, 0, 1), y.narrow(1, 1, 1));
        let on_r = self.d_r.clone() - self.c_rr.clone() * r - self.c_rl.clone() * l.clone();
        let on_l = self.d_l.clone() - self.c_ll.clone() * l;
        Tensor::cat(vec![on_r, on_l], 0)
    }

    /// The residuals and the network's outputs as plain numbers.
    pub fn evaluate(&self, parameters: &Parameters) -> Result<Evaluation, PinnError> {
        let network = RlMlp::from_parameters(parameters, &self.device);
        Ok(Evaluation {
            outputs: read(network.forward(self.features.clone()), self.backend)?,
            residuals: read(self.residuals(&network), self.backend)?,
        })
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Scales to unit length and returns the length; a column without signal stays as it is.
fn normalise(column: &mut [f64]) -> f64 {
    let length = column.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 {
        column.iter_mut().for_each(|x| *x /= length);
    }
    length
}

/// Removes from `column` its part along the unit vector `direction`; returns that part.
fn project_out(direction: &[f64], column: &mut [f64]) -> f64 {
    let part: f64 = direction.iter().zip(&*column).map(|(d, x)| d * x).sum();
    for (x, d) in column.iter_mut().zip(direction) {
        *x -= part * d;
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl_mlp::RlMlp;
    use crate::slow_model::SlowModel;
    use crate::trial;

    /// Eq. (4) as the paper writes it: the squared residual at every sample time.
    fn direct_l_f(
        branch: &HarmonicBranch,
        samples: &NormalisedWaveform,
        network: &Parameters,
    ) -> f64 {
        let sum: f64 = (0..samples.len())
            .map(|n| {
                let tau_s = n as f64 * samples.dt_s;
                let (r, l) = network.r_l_at(tau_s);
                let mut residual = 0.0;
                for (index, h) in branch.basis.harmonics.iter().enumerate() {
                    let at = branch.phasors(tau_s, index);
                    let rate = Complex::new(0.0, f64::from(*h) * samples.omega);
                    let di = at.slope + rate * at.i;
                    let r_h = at.v - (at.i * r + di * l) * samples.impedance_scale();
                    let turn = Complex::from_polar(1.0, f64::from(*h) * samples.omega * tau_s);
                    residual += (r_h * turn).re;
                }
                residual * residual
            })
            .sum();
        sum / samples.len() as f64
    }

    #[test]
    fn parseval_at_slow_times_equals_the_sum_over_all_samples() {
        let (samples, network) = (trial::samples(), trial::network());
        let branch = trial::fitted(&samples);
        let physics = trial::physics(&branch, &samples, &network, &[0, 1], 128);
        let model = SlowModel::own(&physics, &samples, &network);
        let at = model.evaluate(&network).expect("own code");
        let slow = (at.squares() + physics.floor) / trial::W_F;
        let direct = direct_l_f(&branch, &samples, &network);
        assert!(
            direct > 1e-4,
            "the trial network is off, so there is a residual"
        );
        assert!(
            (slow / direct - 1.0).abs() < 1e-3,
            "{slow} against {direct}"
        );
    }

    #[test]
    fn the_constant_of_a_constant_load_is_that_load() {
        let (samples, network) = (trial::samples(), trial::network());
        let branch = trial::fitted(&samples);
        let physics = trial::physics(&branch, &samples, &network, &[0], 64);
        let [r, l] = physics.best_constant();
        assert!((r * 4.0 / 4.0 - 1.0).abs() < 1e-4 && (l * 20.0 / 20.0 - 1.0).abs() < 1e-4);
    }

    #[test]
    fn the_burn_tensors_and_the_plain_parameters_are_one_function() {
        let (samples, network) = (trial::samples(), trial::network());
        let backend = Backend::Ndarray;
        let device = trial::device();
        let module = RlMlp::from_parameters(&network, &device);
        let features = network.embedding.features(3e-3, samples.f_mains_hz);
        let row = matrix(features.clone(), [1, features.len()], &device);
        let y = read(module.forward(row), backend).expect("readable");
        let (r, l) = network.r_l_at(3e-3);
        assert!((y[0] * network.r_scale_ohm - r).abs() < 1e-12);
        assert!((y[1] * network.l_scale_h - l).abs() < 1e-17);
    }
}
