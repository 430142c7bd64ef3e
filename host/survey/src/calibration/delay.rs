//! Delay by a fraction of a sample.

use std::f64::consts::{PI, TAU};

/// Samples on each side that an interpolated one uses: up to a third of the sampling rate the error stays below 1e-3, at a
/// fundamental of a twentieth of it below 1e-5.
const HALF: usize = 16;

/// Delays by `by` samples, whole or not, negative for earlier: y(k) = x(k − by), by a sinc under a
/// Blackman window. Beyond the ends the end samples repeat.
pub(super) fn delay(x: &mut [f32], by: f64) {
    if x.is_empty() || by == 0.0 || !by.is_finite() {
        return;
    }
    // y(k) is interpolated around x[k − whole − 1] … x[k − whole], at `part` before the latter.
    let whole = by.floor();
    let part = by - whole;
    let mut taps: Vec<f64> = (0..2 * HALF)
        .map(|j| {
            // Distance of tap j's sample from the interpolated point.
            let d = j as f64 - HALF as f64 + part;
            let phase = d / HALF as f64;
            let window = 0.42 + 0.5 * libm::cos(PI * phase) + 0.08 * libm::cos(TAU * phase);
            let sinc = if d == 0.0 {
                1.0
            } else {
                libm::sin(PI * d) / (PI * d)
            };
            sinc * if phase.abs() < 1.0 { window } else { 0.0 }
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|t| *t /= sum);
    let last = x.len() - 1;
    let whole = whole.clamp(-(x.len() as f64), x.len() as f64) as isize;
    // The samples, with their ends repeated as far as the taps reach.
    let reach = HALF as isize;
    let first = -whole - reach;
    let source: Vec<f64> = (0..x.len() as isize + 2 * reach)
        .map(|n| f64::from(x[(n + first).clamp(0, last as isize) as usize]))
        .collect();
    for (k, y) in x.iter_mut().enumerate() {
        let taken = &source[k..k + 2 * HALF];
        *y = taken.iter().zip(&taps).map(|(x, t)| x * t).sum::<f64>() as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_delayed_and_keep_their_amplitude() {
        for (cycles, tolerance) in [(0.05, 1e-5), (0.15, 1e-4), (0.33, 1e-3)] {
            for by in [0.3, -0.3, 0.0183, -1.75, 5.0, 2.999] {
                let wave = |k: f64| (TAU * cycles * k + 0.3).sin();
                let mut x: Vec<f32> = (0..400).map(|k| wave(f64::from(k)) as f32).collect();
                delay(&mut x, by);
                for (k, y) in x.iter().enumerate().take(360).skip(40) {
                    let error = f64::from(*y) - wave(k as f64 - by);
                    assert!(error.abs() < tolerance, "{cycles} {by} {k}: {error}");
                }
            }
        }
    }

    #[test]
    fn constants_short_ones_and_absurd_delays_pass() {
        for by in [0.5, -7.2, 1e9, -1e9] {
            let mut x = [2.5f32; 5];
            delay(&mut x, by);
            assert!(x.iter().all(|x| (x - 2.5).abs() < 1e-6), "{by} {x:?}");
        }
        delay(&mut [], 0.5);
    }
}
