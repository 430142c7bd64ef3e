//! Amplitude spectrum for figures.

use ihd_signal::fourier;

/// Most samples of a frame.
const MAX_FRAME_SAMPLES: usize = 1 << 17;

/// Lowest level of the result, in decibel below the largest line.
const FLOOR_DB: f64 = -120.0;

/// Amplitudes of a channel under a Hann window up to `to_hz`, as frequency in hertz and decibel relative to the largest; uses
/// at most 2¹⁷ samples from the middle.
pub fn amplitude_db(x: &[f32], dt_s: f64, to_hz: f64) -> Vec<(f64, f64)> {
    let n = x.len().min(MAX_FRAME_SAMPLES) / 2 * 2;
    if n < 4 {
        return Vec::new();
    }
    let start = (x.len() - n) / 2;
    let fft = fourier::forward(n);
    let (mut input, mut output) = (fft.make_input_vec(), fft.make_output_vec());
    let window = fourier::periodic_hann(n);
    for ((y, x), w) in input.iter_mut().zip(&x[start..start + n]).zip(window) {
        *y = f64::from(*x) * w;
    }
    if fft.process(&mut input, &mut output).is_err() {
        return Vec::new();
    }
    let hz = 1.0 / (n as f64 * dt_s);
    let last = ((to_hz / hz) as usize).min(output.len() - 1);
    let shown = &output[1..=last.max(1)];
    let top = shown
        .iter()
        .map(|y| y.norm_sqr())
        .fold(f64::MIN_POSITIVE, f64::max);
    let db = |power: f64| (10.0 * (power / top).log10()).max(FLOOR_DB);
    let line = |(k, y): (usize, &nalgebra::Complex<f64>)| ((k + 1) as f64 * hz, db(y.norm_sqr()));
    shown.iter().enumerate().map(line).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn lines_stand_where_they_are_and_as_high() {
        let dt_s = 1e-6;
        let wave = |k: i32| {
            let t = f64::from(k) * dt_s;
            ((TAU * 50e3 * t).sin() + 0.1 * (TAU * 150e3 * t).sin()) as f32
        };
        let x: Vec<f32> = (0..10_000).map(wave).collect();
        let spectrum = amplitude_db(&x, dt_s, 200e3);
        let at = |f: f64| spectrum.iter().find(|p| (p.0 - f).abs() < 51.0).unwrap().1;
        assert!(at(50e3).abs() < 1e-6 && (at(150e3) + 20.0).abs() < 0.01);
        assert!(at(100e3) < -80.0);
        assert!(amplitude_db(&[1.0], dt_s, 1.0).is_empty());
    }
}
