//! White noise of the samples, and its effect on the physics residuals.

use crate::harmonic_branch::HarmonicBranch;
use crate::parameters::OUTPUTS;
use crate::waveform::NormalisedWaveform;

/// Variance of the white noise of the normalised points, (v, i): from the configuration's measured noise of the samples, else
/// from the residual of the fit, where `losses` are L_i1, L_i2.
pub(crate) fn white_noise(
    samples: &NormalisedWaveform,
    branch: &HarmonicBranch,
    losses: (f64, f64),
    measured: Option<[f64; 2]>,
) -> (f64, f64) {
    if let Some([v_volt, i_ampere]) = measured {
        let block = samples.block as f64;
        return (
            (v_volt / samples.v_max_volt).powi(2) / block,
            (i_ampere / samples.i_max_ampere).powi(2) / block,
        );
    }
    // The fit has absorbed this share of the noise into its coefficients.
    let free = (1.0 - branch.basis.len() as f64 / samples.len() as f64).max(0.1);
    (losses.0 / free, losses.1 / free)
}

/// Variance of one residual e by white noise of the samples, with `white` that of
/// [`white_noise`] and `r_l` a typical (R in ohm, L in H).
///
/// Noise of variance s^2 per sample enters the mean in eq. (4) as that of a phasor from
/// N / K samples per slow time, 2 s^2 K / N; e contains sqrt(w_f / 2K), and current noise enters
/// times |Z|.
pub(crate) fn noise_variance(
    samples: &NormalisedWaveform,
    white: (f64, f64),
    w_f: f64,
    r_l: [f64; OUTPUTS],
) -> f64 {
    let [r, l] = r_l.map(|s| s * samples.impedance_scale());
    let z_squared = r * r + (samples.omega * l).powi(2);
    w_f / samples.len() as f64 * (white.0 + z_squared * white.1)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::trial;

    #[test]
    fn noise_moves_the_constant_as_far_as_its_standard_deviation() {
        let (samples, network) = (trial::samples(), trial::network());
        let deviation = 0.02;
        // Uniform noise of that standard deviation.
        let reach = deviation * 3.0_f64.sqrt();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (mut squares, mut predicted) = (0.0, 0.0);
        let runs = 40;
        for _ in 0..runs {
            let mut noisy = samples.clone();
            for x in noisy.v.iter_mut().chain(&mut noisy.i) {
                *x += rng.random_range(-reach..reach);
            }
            let branch = trial::fitted(&noisy);
            let physics = trial::physics(&branch, &noisy, &network, &[0], 64);
            let constant = physics.best_constant();
            // R is the looser of the two: 4 ohm.
            squares += (constant[0] * network.r_scale_ohm / 4.0 - 1.0).powi(2);
            let white = (deviation * deviation, deviation * deviation);
            let noise = noise_variance(&noisy, white, trial::W_F, [4.0, 20e-6]);
            predicted += physics.relative_sigma(constant, noise) / f64::from(runs);
        }
        let seen = (squares / f64::from(runs)).sqrt();
        // 40 runs give a standard deviation to 11 %.
        assert!(
            (0.7..1.4).contains(&(seen / predicted)),
            "{seen} seen, {predicted} predicted"
        );
    }
}
