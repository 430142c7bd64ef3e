//! The estimators' accuracy on the behavioural reference load against the targets of
//! docs/accuracy.md, at the lowest and the highest of the paper's frequencies, without noise and at
//! 30 dB. `ihd-study estimators` has all cells.

use ihd_identify::accuracy::Accuracy;
use ihd_identify::{IdentifyOptions, Method, run};
use ihd_signal::Segment;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::trial::Trial;
use ihd_study::estimators::published;

/// Errors over the last half-cycle of a mains cycle.
fn accuracy(trial: &Trial, segment: &Segment, method: Method) -> Accuracy {
    let estimate = run(method, segment, &IdentifyOptions::default()).expect("it identifies");
    Accuracy::measure(&estimate, segment, &trial.truth, 10e-3).expect("there is truth")
}

#[test]
fn targets_on_the_reference_load_are_met_at_45_and_70_khz() {
    for f_sw_hz in [45e3, 70e3] {
        let trial = Trial::simulate(LoadKind::Behavioural, f_sw_hz).expect("the preset simulates");
        for snr_db in [None, Some(30.0)] {
            let segment = trial.noisy(snr_db, 5);
            let whole = |method| accuracy(&trial, &segment, method).whole;
            let within = |method: Method, r_pct: f64, l_pct: f64| {
                let e = whole(method);
                assert!(
                    e.r_pct <= r_pct && e.l_pct <= l_pct,
                    "{method} at {f_sw_hz} Hz, {snr_db:?}: {e:?}, limit {r_pct}/{l_pct}"
                );
            };
            match snr_db {
                None => {
                    within(Method::LeastSquares, 0.1, 0.3);
                    within(Method::Lockin, 0.2, 0.15);
                    within(Method::Pinn, 0.5, 0.5);
                }
                Some(_) => {
                    within(Method::LeastSquares, 0.5, 0.6);
                    within(Method::Pinn, 1.0, 1.0);
                }
            }
            let paper = published::ekf(f_sw_hz, snr_db)
                .expect("a cell of the paper")
                .mre;
            within(Method::Ekf, paper.r_pct, paper.l_pct);
            // A smoother that sees the future must not be worse than the filter it smooths.
            let ekf = whole(Method::Ekf);
            within(Method::Rts, ekf.r_pct, ekf.l_pct);
        }
    }
}

/// The error bars mean something: at 30 dB most of the errors of the middle 80 % lie within three
/// standard deviations, and the deviations are not ten times too wide.
#[test]
fn error_bars_of_least_squares_and_lock_in_are_those_of_the_noise() {
    let trial = Trial::simulate(LoadKind::Behavioural, 60e3).expect("the preset simulates");
    let segment = trial.noisy(Some(30.0), 2);
    let clean = trial.noisy(None, 0);
    for method in [Method::LeastSquares, Method::Lockin] {
        let noisy = run(method, &segment, &IdentifyOptions::default()).expect("it identifies");
        let bare = run(method, &clean, &IdentifyOptions::default()).expect("it identifies");
        assert_eq!(noisy.t_s, bare.t_s);
        let middle = |k: &usize| (11e-3..19e-3).contains(&noisy.t_s[*k]);
        let ratios: Vec<f64> = (0..noisy.t_s.len())
            .filter(middle)
            .map(|k| (noisy.r_ohm[k] - bare.r_ohm[k]) / noisy.r_sigma_ohm[k])
            .collect();
        let rms = (ratios.iter().map(|x| x * x).sum::<f64>() / ratios.len() as f64).sqrt();
        assert!(
            (0.3..3.0).contains(&rms),
            "{method}: errors of {rms:.2} deviations"
        );
    }
}
