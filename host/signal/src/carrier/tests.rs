use std::f64::consts::TAU;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::warp::Warp;

/// 290 V and 42 A under a mains envelope of 50 Hz, the current half a radian late, with a third harmonic.
fn swept(rate_hz: f64, f: impl Fn(f64) -> f64, snr_db: Option<f64>) -> Segment {
    let n = (20e-3 * rate_hz) as usize;
    let dt_s = 1.0 / rate_hz;
    let noise = snr_db.map_or(0.0, |db| 0.5 * libm::pow(10.0, -db / 20.0));
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut draw = move || -> f64 { StandardNormal.sample(&mut random) };
    let (mut v_v, mut i_a, mut angle) = (Vec::new(), Vec::new(), 0.3);
    for k in 0..n {
        let t_s = k as f64 * dt_s;
        let envelope = libm::sin(TAU * 50.0 * t_s).abs();
        let v = libm::cos(angle) + 0.3 * libm::cos(3.0 * angle);
        v_v.push(290.0 * (envelope * v + noise * draw()));
        i_a.push(42.0 * (envelope * libm::cos(angle - 0.5) + noise * draw()));
        angle += TAU * f(t_s + 0.5 * dt_s) * dt_s;
    }
    Segment {
        f_sw_hz: 50e3,
        mains_hz: 50.0,
        zero_crossing_s: 0.0,
        t0_s: 0.0,
        dt_s,
        v_v: v_v.into(),
        i_a: i_a.into(),
    }
}

fn sweep(deviation_hz: f64, rate_hz: f64) -> impl Fn(f64) -> f64 {
    move |t_s| 50e3 + deviation_hz * libm::sin(TAU * rate_hz * t_s)
}

#[test]
fn a_sweep_is_followed_at_any_rate_and_in_noise() {
    for (deviation, rate) in [(5e3, 100.0), (1e3, 1e3)] {
        for (sampling, snr_db) in [(50e6, None), (2.5e6, Some(30.0)), (1e6, None)] {
            let f = sweep(deviation, rate);
            let segment = swept(sampling, &f, snr_db);
            let carrier = Carrier::from_segment(&segment).unwrap();
            assert!(carrier.moves());
            let seen = carrier.sweep();
            assert!(
                (seen.deviation_hz / deviation - 1.0).abs() < 0.05,
                "{seen:?}"
            );
            assert!((seen.rate_hz / rate - 1.0).abs() < 0.15, "{seen:?}");
            let strong: Vec<_> = carrier.values().filter(|v| v.2 > 0.1).collect();
            let square = strong.iter().map(|(t, found, _)| (found - f(*t)).powi(2));
            let rms = (square.sum::<f64>() / strong.len() as f64).sqrt();
            // A sweep of 1 kHz loses 2 % to the cut-off.
            assert!(
                rms < 30.0 + 0.02 * deviation * rate / 1e3,
                "{deviation} {rate} {sampling}: {rms}"
            );
        }
    }
}

#[test]
fn a_constant_carrier_does_not_move() {
    for (sampling, snr_db) in [(50e6, None), (2.5e6, Some(20.0)), (1e6, Some(20.0))] {
        let carrier = Carrier::from_segment(&swept(sampling, |_| 50_013.0, snr_db)).unwrap();
        assert!(!carrier.moves());
        // With half of the margin left.
        let strong = carrier.values().filter(|v| v.2 > 0.2);
        let most = strong.map(|v| (v.1 - 50_013.0).abs()).fold(0.0, f64::max);
        assert!(most < 0.5 * MOVES_HZ, "{most}");
        assert!((carrier.mean_hz() - 50_013.0).abs() < 3.0);
    }
}

#[test]
fn warped_samples_have_one_frequency_and_come_back() {
    let segment = swept(2.5e6, sweep(5e3, 100.0), None);
    let carrier = Carrier::from_segment(&segment).unwrap();
    let warp = Warp::new(&segment, &carrier, 0..25_000);
    let warped = warp.samples();
    let again = Carrier::from_segment(&warped).unwrap();
    assert!(again.sweep().deviation_hz < 15.0, "{:?}", again.sweep());
    let narrow = |x: &[f64]| -> Vec<f32> { x.iter().map(|x| *x as f32).collect() };
    let back = warp.unwarped(&narrow(&warped.i_a));
    for (a, b) in back.iter().zip(&segment.i_a).skip(8).take(24_980) {
        assert!((f64::from(*a) - b).abs() < 42.0 * 2e-5, "{a} {b}");
    }
    // Both ends stay, and the way there and back is one.
    assert!((warp.time_s(0.0)).abs() < 1e-12 && (warp.time_s(10e-3) - 10e-3).abs() < 1e-12);
    let t_s = warp.time_s(3e-3);
    let periods = carrier.periods(t_s) - carrier.periods(0.0);
    assert!((periods / warped.f_sw_hz - 3e-3).abs() < 1e-12);
}
