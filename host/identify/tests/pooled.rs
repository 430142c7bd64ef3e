//! Pooling of half-cycles: only here are pooled errors and deviations compared with a known law.

use std::f64::consts::{PI, TAU};

use ihd_identify::pooled::{PoolPhasors, pool_phasors};
use ihd_signal::Segment;
use ihd_signal::noise::WhiteNoise;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const F_SW_HZ: f64 = 45e3;

/// R in ohm and L in henry at an amplitude in ampere.
fn law(i_a: f64) -> (f64, f64) {
    let r = 2.2 + 3.5 / (1.0 + i_a / 15.0);
    let l = 16e-6 + 15e-6 / (1.0 + (i_a / 14.0).powf(1.5));
    (r, l)
}

/// Drift of R over a segment, as a share; L drifts by half of it.
#[derive(Clone, Copy, Debug)]
enum Drift {
    None,
    /// Total change, in proportion to time.
    Linear(f64),
    /// Final change, of which 1 − exp(−t/τ) is reached, with τ as 0.3 of the segment.
    Saturating(f64),
}

impl Drift {
    /// Change at a share of the segment's time, less its mean over time.
    fn at(self, share: f64) -> f64 {
        let tau: f64 = 0.3;
        match self {
            Self::None => 0.0,
            Self::Linear(size) => size * (share - 0.5),
            Self::Saturating(size) => {
                size * (tau * (1.0 - (-1.0 / tau).exp()) - (-share / tau).exp())
            }
        }
    }
}

/// Half-cycles of v = R i + L di/dt with white noise of 30 dB on both channels, and a drift about the law.
fn segment(half_cycles: usize, rate_hz: f64, drift: Drift, seed: u64) -> Segment {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (n, dt_s) = (
        (half_cycles as f64 * 10e-3 * rate_hz) as usize,
        1.0 / rate_hz,
    );
    let omega = TAU * F_SW_HZ;
    let (mut v_v, mut i_a) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for k in 0..n {
        let t = (k as f64 + 0.5) * dt_s;
        let mains = TAU * 50.0 * t;
        let (envelope, slope) = (
            45.0 * mains.sin().abs(),
            45.0 * TAU * 50.0 * mains.cos() * mains.sin().signum(),
        );
        let (sin, cos) = (omega * t).sin_cos();
        let (r, l) = law(envelope);
        let change = drift.at(k as f64 / n as f64);
        let (r, l) = (r * (1.0 + change), l * (1.0 + 0.5 * change));
        let (i, d) = (envelope * cos, slope * cos - envelope * omega * sin);
        v_v.push(r * i + l * d);
        i_a.push(i);
    }
    for x in [&mut v_v, &mut i_a] {
        let rms = (x.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt();
        x.iter_mut()
            .for_each(|x| *x += rms * 10f64.powf(-1.5) * normal());
    }
    Segment {
        f_sw_hz: F_SW_HZ,
        mains_hz: 50.0,
        zero_crossing_s: 0.0,
        t0_s: 0.5 * dt_s,
        dt_s,
        v_v: v_v.into(),
        i_a: i_a.into(),
    }
}

fn demodulated(segment: &Segment) -> PoolPhasors {
    PoolPhasors::demodulate(segment, WhiteNoise::measure(segment))
}

/// Mean errors of R and L in percent over the middle 80 % of a half-cycle, and root mean squares of error over σ.
fn errors(segment: &Segment) -> ([f64; 2], [f64; 2]) {
    let pooled = pool_phasors(&demodulated(segment)).expect("half-cycles enough");
    let (mut pct, mut squares) = ([0.0; 2], [0.0; 2]);
    let n = 400;
    for k in 0..n {
        let phase = 0.1 + 0.8 * (f64::from(k) + 0.5) / f64::from(n);
        let i_a = 45.0 * (PI * phase).sin();
        let truth = law(i_a);
        for (q, ((x, sigma), truth)) in pooled
            .at(i_a)
            .into_iter()
            .zip([truth.0, truth.1])
            .enumerate()
        {
            pct[q] += 100.0 * (x / truth - 1.0).abs() / f64::from(n);
            squares[q] += ((x - truth) / sigma).powi(2) / f64::from(n);
        }
    }
    (pct, squares)
}

/// Means over seeds.
fn over_seeds(half_cycles: usize, rate_hz: f64, drift: Drift, seeds: u64) -> ([f64; 2], [f64; 2]) {
    let (mut pct, mut squares) = ([0.0; 2], [0.0; 2]);
    for seed in 1..=seeds {
        let (p, s) = errors(&segment(half_cycles, rate_hz, drift, seed));
        for q in 0..2 {
            pct[q] += p[q] / seeds as f64;
            squares[q] += s[q] / seeds as f64;
        }
    }
    println!(
        "{half_cycles} half-cycles at {:.1} MS/s, drift {drift:?}: R {:.3} %, L {:.3} %, z {:.2} {:.2}",
        rate_hz * 1e-6,
        pct[0],
        pct[1],
        squares[0].sqrt(),
        squares[1].sqrt()
    );
    (pct, squares.map(f64::sqrt))
}

#[test]
fn ten_half_cycles_are_better_than_one_and_sigma_holds() {
    let one = over_seeds(1, 2.5e6, Drift::None, 6).0;
    let (ten, z) = over_seeds(10, 2.5e6, Drift::Linear(0.01), 6);
    for q in 0..2 {
        assert!((0.2..0.75).contains(&(ten[q] / one[q])), "{one:?} {ten:?}");
        assert!(ten[q] < [0.07, 0.05][q], "{ten:?}");
        assert!((0.6..1.4).contains(&z[q]), "{z:?}");
    }
}

/// Half-cycles of a long capture come in parts, with frequencies as found in each. A part lacks the phasors at its ends, where the
/// current is small, and the evidence may choose another width of the prior: the laws agree within the deviation that both state.
#[test]
fn parts_pool_as_the_whole_does() {
    let whole = segment(10, 2.5e6, Drift::Linear(0.01), 3);
    let n = whole.len();
    let parts: Vec<PoolPhasors> = [(0, 3 * n / 10), (3 * n / 10, 6 * n / 10), (6 * n / 10, n)]
        .into_iter()
        .enumerate()
        .map(|(k, (from, to))| {
            let mut part = whole.part(from, to);
            // A tenth of a hertz, as a survey may be off.
            part.f_sw_hz += 0.1 * (k as f64 - 1.0);
            demodulated(&part)
        })
        .collect();
    let joined = pool_phasors(&PoolPhasors::joined(&parts).expect("three")).expect("a law");
    let whole = pool_phasors(&demodulated(&whole)).expect("a law");
    for i_a in [8.0, 15.0, 30.0, 43.0] {
        for (a, b) in joined.at(i_a).into_iter().zip(whole.at(i_a)) {
            assert!((a.0 - b.0).abs() < b.1, "{i_a} A: {a:?} {b:?}");
            assert!((a.1 / b.1 - 1.0).abs() < 0.1, "{i_a} A: {a:?} {b:?}");
        }
    }
    let drift = joined.r_drift_ohm;
    assert!((drift.0 - whole.r_drift_ohm.0).abs() < drift.1, "{drift:?}");
    assert!(PoolPhasors::joined(&[]).is_none());
}

/// The figures of docs/accuracy.md. Of one half-cycle the error may be 1.1 times the bound of the law's own flexibility, σ.
#[test]
fn pooled_errors_at_length() {
    let (none, linear, saturating) = (Drift::None, Drift::Linear(0.01), Drift::Saturating(0.01));
    let most_of = |half_cycles| match half_cycles {
        1 => ([0.1, 0.08], 1.1),
        10 => ([0.07, 0.05], 1.3),
        _ => ([0.03, 0.02], 1.3),
    };
    for rate_hz in [2.5e6, 12.5e6] {
        for (half_cycles, drift) in [
            (1, none),
            (10, linear),
            (10, saturating),
            (100, linear),
            (100, saturating),
        ] {
            let seeds = if half_cycles == 1 { 30 } else { 6 };
            let (pct, z) = over_seeds(half_cycles, rate_hz, drift, seeds);
            let (most_pct, most_z) = most_of(half_cycles);
            for q in 0..2 {
                assert!(pct[q] < most_pct[q], "{half_cycles}: {pct:?}");
                assert!((0.6..most_z).contains(&z[q]), "{half_cycles}: {z:?}");
            }
        }
    }
}
