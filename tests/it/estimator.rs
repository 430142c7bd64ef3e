//! The firmware's demodulator and fixed-point filter on recorded half-cycles: against the truth, and
//! against their f64 twins.

use ihd_firmware::estimate::ekf::{Ekf, Noise};
use ihd_firmware::sense::correlation::correlate;
use ihd_firmware::sense::demodulator::Demodulator;
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_tests::half_cycle::{F_SW_HZ, HalfCycle};
use ihd_tests::oracle::{self, Jacobian};

/// The nominal load, from which the filters start: R in ohm, L in henry.
const START: (f64, f64) = (4.0, 25e-6);

/// (time, R, L) per block by the firmware.
fn firmware_track(h: &HalfCycle) -> Vec<(f64, f64, f64)> {
    let (r, l) = (
        MicroOhm((START.0 * 1e6) as i32),
        PicoHenry((START.1 * 1e12) as i32),
    );
    let mut demod = Demodulator::new(h.f_sw_hz);
    let mut ekf = Ekf::new(h.f_sw_hz, r, l, Noise::TUNED);
    let mut track = Vec::new();
    for (k, block) in h.blocks().enumerate() {
        if let Some(phasors) = demod.push(&correlate(block)) {
            ekf.step(&phasors);
            let centre = (k as f64 + 0.5 - f64::from(demod.delay_blocks())) * h.block_s();
            track.push((centre, ekf.r().ohm(), ekf.l().henry()));
        }
    }
    track
}

/// (time, R, L) per block by the f64 twins.
fn oracle_track(h: &HalfCycle, jacobian: Jacobian) -> Vec<(f64, f64, f64)> {
    let blocks: Vec<_> = h.blocks().copied().collect();
    let (delay, phasors) = oracle::demodulate(&blocks, h.f_sw_hz);
    let mut ekf = oracle::Ekf::new(h.f_sw_hz, START.0, START.1, jacobian);
    let mut track = Vec::new();
    for (k, (v, i)) in phasors.into_iter().enumerate() {
        ekf.step(v, i);
        let (r, l) = ekf.r_l();
        track.push(((k + delay) as f64 * h.block_s() + 0.5 * h.block_s(), r, l));
    }
    track
}

/// Mean relative errors of R and L in percent over a share of the half-cycle around its middle.
fn mre(h: &HalfCycle, track: &[(f64, f64, f64)], share: f64) -> (f64, f64) {
    let (from, to) = (10e-3 * (0.5 - share / 2.0), 10e-3 * (0.5 + share / 2.0));
    let inside: Vec<_> = track
        .iter()
        .filter(|p| (from..=to).contains(&p.0))
        .collect();
    assert!(inside.len() > 100, "{} estimates", inside.len());
    let mut sum = (0.0, 0.0);
    for (t, r, l) in &inside {
        let (r0, l0) = h.at(*t);
        sum.0 += (r / r0 - 1.0).abs();
        sum.1 += (l / l0 - 1.0).abs();
    }
    let scale = 100.0 / inside.len() as f64;
    (sum.0 * scale, sum.1 * scale)
}

fn check(noise: &str, r_limit: f64, l_limit: f64) {
    for f in F_SW_HZ {
        let h = HalfCycle::load(f, noise).unwrap();
        let track = firmware_track(&h);
        let (r, l) = mre(&h, &track, 0.8);
        let (r_whole, l_whole) = mre(&h, &track, 1.0);
        println!("{f} {noise}: middle 80 % {r:.3}/{l:.3} %, whole {r_whole:.3}/{l_whole:.3} %");
        assert!(
            r <= r_limit && l <= l_limit,
            "{f} Hz {noise}: {r:.3} % {l:.3} %"
        );
    }
}

#[test]
fn noiseless_within_one_and_half_a_percent() {
    check("noiseless", 1.0, 0.5);
}

#[test]
fn thirty_decibel_within_two_and_one_percent() {
    check("snr30", 2.0, 1.0);
}

/// Fixed point within 0.1 % of the f64 twin everywhere, from the first estimate to the last.
#[test]
fn fixed_point_follows_its_f64_twin() {
    for f in F_SW_HZ {
        for noise in ["noiseless", "snr30"] {
            let h = HalfCycle::load(f, noise).unwrap();
            let (fixed, float) = (firmware_track(&h), oracle_track(&h, Jacobian::Analytic));
            assert_eq!(fixed.len(), float.len());
            let mut worst = (0.0f64, 0.0f64);
            for (a, b) in fixed.iter().zip(&float) {
                assert!((a.0 - b.0).abs() < 1e-9);
                worst.0 = worst.0.max((a.1 / b.1 - 1.0).abs());
                worst.1 = worst.1.max((a.2 / b.2 - 1.0).abs());
            }
            println!(
                "{f} {noise}: worst {:.4} % R, {:.4} % L",
                worst.0 * 100.0,
                worst.1 * 100.0
            );
            assert!(
                worst.0 <= 1e-3 && worst.1 <= 1e-3,
                "{f} Hz {noise}: {worst:?}"
            );
        }
    }
}

/// The filter takes L/dt as known when it differentiates: that must cost no accuracy worth having.
#[test]
fn the_exact_jacobian_is_no_better() {
    for f in F_SW_HZ {
        for noise in ["noiseless", "snr30"] {
            let h = HalfCycle::load(f, noise).unwrap();
            for share in [0.8, 1.0] {
                let error = |jacobian| mre(&h, &oracle_track(&h, jacobian), share);
                let (analytic, exact) = (error(Jacobian::Analytic), error(Jacobian::Exact));
                println!("{f} {noise} {share}: analytic {analytic:.4?} %, exact {exact:.4?} %");
                assert!(
                    analytic.0 - exact.0 <= 0.01 && analytic.1 - exact.1 <= 0.01,
                    "{f} Hz {noise} {share}: {analytic:?} against {exact:?}"
                );
            }
        }
    }
}
