//! The noise measured between the lines, on captures whose noise is known sample by sample.

use std::f64::consts::TAU;

use ihd_signal::Segment;
use ihd_signal::noise::{WhiteNoise, deviation};
use ihd_sim::recording::run::{SimulatedRecording, record};
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn rms(x: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = x.fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
    f64::sqrt(sum / n)
}

fn normal(seed: u64, n: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| StandardNormal.sample(&mut rng)).collect()
}

/// Behavioural load, 20 ms, on a bus with ripple and a distorted mains, with dead time: edges that alias.
fn recorded(f_sw_hz: f64, rate: Rate, bits: u32, snr_db: Option<f64>) -> SimulatedRecording {
    let settings = CaptureSpec {
        load: LoadKind::Behavioural,
        f_sw_hz,
        mains_harmonics: [0.04, -0.02, 0.0],
        bus_capacitance_f: 5e-6,
        dead_s: 0.6e-6,
        sensing: Sensing {
            rate,
            allow_aliasing: true,
            bits,
            snr_db,
            ..Sensing::default()
        },
        ..CaptureSpec::default()
    };
    record(&settings, |_| ()).expect("settings that can be")
}

/// Samples of the recording, and the deviations of its noise with the rounding of its converters.
fn noisy(recording: &SimulatedRecording) -> (Segment, [f64; 2]) {
    let clean = recording.clean_segment();
    let volts = recording
        .v_code
        .iter()
        .map(|c| f64::from(*c) * recording.volt_per_code());
    let amperes = recording
        .i_code
        .iter()
        .map(|c| f64::from(*c) * recording.ampere_per_code());
    let noisy = clean.with_samples(volts.collect(), amperes.collect());
    let of = |x: &[f64], clean: &[f64]| rms(x.iter().zip(clean).map(|(a, b)| a - b));
    let right = [of(&noisy.v_v, &clean.v_v), of(&noisy.i_a, &clean.i_a)];
    (noisy, right)
}

#[test]
fn white_noise_alone_is_measured_without_bias() {
    // Over seeds the mean ratio is 1, whatever the length and with it the number of frames.
    for (n, per_period) in [
        (1_300, 61.0 / 3.0),
        (9_150, 61.0 / 3.0),
        (40_000, 22.2),
        (300_000, 277.8),
    ] {
        let ratios = (0..12).map(|seed| deviation(&normal(seed, n), per_period).unwrap() / 1.0);
        let ratios: Vec<f64> = ratios.collect();
        let mean = ratios.iter().sum::<f64>() / 12.0;
        let spread = rms(ratios.iter().map(|r| r - mean));
        println!("{n} samples, {per_period} a period: {mean:.3} ± {spread:.3}");
        assert!((mean - 1.0).abs() < 0.02 + spread / 3.0, "{n}: {mean}");
        assert!(spread < if n > 5_000 { 0.05 } else { 0.2 }, "{n}: {spread}");
    }
}

/// Switching frequency in hertz and sampling rate.
const RATES: [(f64, Rate); 9] = [
    (36e3, Rate::Locked),
    (41.7e3, Rate::Locked),
    (63e3, Rate::Locked),
    (41.7e3, Rate::Hz(2.5e6)),
    (45e3, Rate::Hz(2.5e6)),
    (79e3, Rate::Hz(2.5e6)),
    (38e3, Rate::Hz(10e6)),
    (60e3, Rate::Hz(50e6)),
    (45e3, Rate::Hz(125e6)),
];

/// Bits of the converter, and signal-to-noise ratio in decibel.
const NOISES: [(u32, Option<f64>); 6] = [
    (8, Some(20.0)),
    (12, Some(30.0)),
    (12, Some(50.0)),
    (16, Some(70.0)),
    (12, None),
    (16, None),
];

#[test]
fn noise_is_found_beneath_the_harmonics_at_every_rate_and_frequency() {
    for (k, rate) in RATES.into_iter().enumerate().take(7) {
        assert_is_found(rate, NOISES[k % 6]);
        assert_is_found(rate, NOISES[(k + 3) % 6]);
    }
    assert_is_found(RATES[7], NOISES[1]);
}

#[test]
fn noise_is_found_beneath_the_harmonics_all_variants() {
    for rate in RATES {
        for noise in NOISES {
            assert_is_found(rate, noise);
        }
    }
}

fn assert_is_found((f_sw_hz, rate): (f64, Rate), (bits, snr_db): (u32, Option<f64>)) {
    let (segment, right) = noisy(&recorded(f_sw_hz, rate, bits, snr_db));
    let found = WhiteNoise::measure(&segment);
    let ratios = [found.v_v / right[0], found.i_a / right[1]];
    println!("{f_sw_hz} {rate:?} {bits} {snr_db:?}: {ratios:.2?}");
    for ratio in ratios {
        // Beneath 60 dB edges that alias fill the gaps, and rounding repeats with the waveform.
        let tolerance = if snr_db.is_some_and(|db| db < 60.0) {
            0.2
        } else {
            0.8
        };
        let hidden = ratio > 1.0 && found.v_v < 2e-3 * rms(segment.v_v.iter().copied());
        assert!(
            (ratio - 1.0).abs() < tolerance || hidden,
            "{f_sw_hz} {rate:?} {bits} {snr_db:?}: {ratio}"
        );
    }
}

#[test]
fn a_neighbours_coil_is_not_taken_for_noise() {
    let recording = recorded(45e3, Rate::Hz(2.5e6), 12, Some(45.0));
    let (mut segment, right) = noisy(&recording);
    for (order, v) in [(1.0, 8.0), (3.0, 2.0), (5.0, 1.0)] {
        for k in 0..segment.len() {
            let turn = order * (segment.f_sw_hz + 1.2e3) * segment.t_s(k);
            let envelope = libm::sin(TAU * 50.0 * segment.t_s(k)).abs();
            segment.v_v[k] += v * envelope * libm::cos(TAU * turn.fract());
        }
    }
    let found = WhiteNoise::measure(&segment);
    assert!(
        (found.v_v / right[0] - 1.0).abs() < 0.25,
        "{found:?} {right:?}"
    );
}
