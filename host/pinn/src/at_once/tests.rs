//! The law against simulated loads, and what it costs beside the network.

use std::time::Instant;

use super::loads::{Kind, Recorded, recordings};
use crate::{Identification, PinnConfig, identify};

/// Loads that the network did not learn.
const UNLIKE: [Kind; 2] = [Kind::Knee, Kind::Moving];

fn at_once() -> PinnConfig {
    PinnConfig {
        at_once: true,
        ..PinnConfig::default()
    }
}

/// Mean relative errors of R and L in percent, and their root mean square over σ, over the middle 80 %.
fn errors(found: &Identification, recorded: &Recorded) -> [f64; 4] {
    let mut sums = [0.0; 4];
    let mut count = 0.0;
    for (k, t_s) in found.t_s.iter().enumerate() {
        if !(1e-3..9e-3).contains(t_s) {
            continue;
        }
        let (r, l) = recorded.load.r_l(t_s / 10e-3);
        let (by_r, by_l) = (found.r_ohm[k] - r, found.l_h[k] - l);
        sums[0] += 100.0 * (by_r / r).abs();
        sums[1] += 100.0 * (by_l / l).abs();
        sums[2] += (by_r / found.r_sigma_ohm[k]).powi(2);
        sums[3] += (by_l / found.l_sigma_h[k]).powi(2);
        count += 1.0;
    }
    let [r, l, zr, zl] = sums.map(|sum| sum / count);
    [r, l, zr.sqrt(), zl.sqrt()]
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count() as f64
}

#[test]
fn the_law_finds_loads_like_those_that_it_was_learned_from() {
    for recorded in recordings(&Kind::LEARNED, 24, 3) {
        let found = identify(&recorded.waveform(), &at_once(), &mut |_| ()).expect("sound");
        let [_, _, z_r, z_l] = errors(&found, &recorded);
        // A window has some five independent errors: their root mean square is within 2.5 in all but one of 10,000.
        assert!(z_r < 2.5 && z_l < 2.5, "{:?}: {z_r} {z_l}", recorded.load);
        let again = identify(&recorded.waveform(), &at_once(), &mut |_| ()).expect("sound");
        assert_eq!(
            (found.r_ohm, found.l_sigma_h),
            (again.r_ohm, again.l_sigma_h)
        );
    }
}

#[test]
fn the_network_is_trained_where_the_law_leaves_a_residual() {
    for recorded in recordings(&UNLIKE, 4, 3) {
        let found = identify(&recorded.waveform(), &at_once(), &mut |_| ()).expect("sound");
        let hybrid = PinnConfig::default();
        let right = identify(&recorded.waveform(), &hybrid, &mut |_| ()).expect("sound");
        assert!(found.iterations > 0 && found.r_ohm == right.r_ohm);
    }
}

/// The figures of docs/accuracy.md: `cargo test --release -p ihd-pinn law_beside_the_network -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement, whatever it gives"]
fn law_beside_the_network() {
    for kind in Kind::LEARNED.into_iter().chain(UNLIKE) {
        for (name, config) in [("at-once", at_once()), ("hybrid", PinnConfig::default())] {
            let mut all = Vec::new();
            for recorded in recordings(&[kind], 40, 7) {
                let best = (0..5).map(|_| {
                    let before = Instant::now();
                    let found =
                        identify(&recorded.waveform(), &config, &mut |_| ()).expect("sound");
                    (1e3 * before.elapsed().as_secs_f64(), found)
                });
                let (ms, found) = best.min_by(|a, b| a.0.total_cmp(&b.0)).expect("five");
                all.push((
                    ms,
                    found.iterations == 0,
                    errors(&found, &recorded),
                    mean(found.chi2.iter().copied()),
                ));
            }
            let error = |k: usize| mean(all.iter().map(|a| a.2[k]));
            let z = |k: usize| mean(all.iter().map(|a| a.2[k].powi(2))).sqrt();
            let by_law = all.iter().filter(|a| a.1);
            println!(
                "{kind:?} {name}: {} of {} by the law in {:.2} ms, all {:.2} ms, R {:.3} % L {:.3} %, z {:.2} {:.2}, chi2 {:.2}",
                by_law.clone().count(),
                all.len(),
                mean(by_law.map(|a| a.0)),
                mean(all.iter().map(|a| a.0)),
                error(0),
                error(1),
                z(2),
                z(3),
                mean(all.iter().map(|a| a.3)),
            );
        }
    }
}
