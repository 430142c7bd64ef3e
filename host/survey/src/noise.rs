//! White noise of a channel: the floor of its spectrum between the lines.

use realfft::RealFftPlanner;

use super::track::hann;

/// Longest frame, in samples.
const LONGEST: usize = 1 << 16;

/// Shortest frame that separates lines: eight switching periods.
const LEAST_PERIODS: f64 = 8.0;

/// Most frames that are looked at.
const MOST_FRAMES: usize = 8;

/// The quantile of the bins that is taken: lines and their sidebands, harmonics beyond half the rate
/// included, may fill four fifths of the spectrum.
const QUANTILE: f64 = 0.2;

/// Standard deviation of a channel's white noise, in its unit; `None` when the samples are too few.
///
/// Power of white noise in a bin is exponentially distributed, and its quantile q is −ln(1 − q) of its
/// mean. The median of the frames counts, so that single events do not.
pub fn deviation(x: &[f32], samples_per_period: f64) -> Option<f64> {
    let least = (LEAST_PERIODS * samples_per_period).ceil() as usize;
    let n = x.len().min(LONGEST);
    // The largest power of two is the fastest.
    let n = if n.is_power_of_two() {
        n
    } else {
        n.next_power_of_two() / 2
    };
    if n < least.max(64) {
        return None;
    }
    let fft = RealFftPlanner::new().plan_fft_forward(n);
    let window = hann(n);
    let (mut input, mut output) = (fft.make_input_vec(), fft.make_output_vec());
    let count = (x.len() / n).min(MOST_FRAMES);
    let stride = (x.len() - n) / count.max(2).saturating_sub(1).max(1);
    let mut floors = Vec::with_capacity(count);
    for frame in 0..count {
        let x = &x[frame * stride..frame * stride + n];
        let mean = x.iter().map(|x| f64::from(*x)).sum::<f64>() / n as f64;
        for ((y, x), w) in input.iter_mut().zip(x).zip(&window) {
            *y = (f64::from(*x) - mean) * w;
        }
        fft.process(&mut input, &mut output).ok()?;
        let mut power: Vec<f64> = output[1..n / 2].iter().map(|y| y.norm_sqr()).collect();
        let at = (QUANTILE * power.len() as f64) as usize;
        let (_, floor, _) = power.select_nth_unstable_by(at, f64::total_cmp);
        // Σ w² of a Hann window is 3n/8.
        floors.push(*floor / (-(1.0 - QUANTILE).ln() * 0.375 * n as f64));
    }
    floors.sort_by(f64::total_cmp);
    floors.get(floors.len() / 2).map(|variance| variance.sqrt())
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// A square wave whose edges take a hundredth of the period (0.2 µs at 45 kHz), harmonics beyond
    /// half the rate included.
    fn square(n: usize, per_period: f64, sigma: f64) -> Vec<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        (0..n)
            .map(|k| {
                let phase = (k as f64 / per_period).fract();
                let from_edge = phase.min((phase - 0.5).abs()).min(1.0 - phase);
                let ramp = (from_edge / 0.005).min(1.0);
                let noise: f64 = StandardNormal.sample(&mut rng);
                (if phase < 0.5 { ramp } else { -ramp } + sigma * noise) as f32
            })
            .collect()
    }

    #[test]
    fn noise_is_found_beneath_the_harmonics() {
        for per_period in [61.0 / 3.0, 22.2, 277.8, 1111.1] {
            for sigma in [3e-3, 30e-3] {
                let x = square(1 << 17, per_period, sigma);
                let got = deviation(&x, per_period).unwrap();
                assert!(
                    (got / sigma - 1.0).abs() < 0.25,
                    "{per_period} {sigma}: {got}"
                );
            }
        }
        assert_eq!(deviation(&square(100, 50.0, 0.1), 50.0), None);
    }
}
