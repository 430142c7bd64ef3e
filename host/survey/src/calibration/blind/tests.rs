//! Against the simulator's sensing chain, whose settings are the truth.

use std::f64::consts::TAU;

use ihd_signal::segment::Segment;
use ihd_signal::{Capture, Load};
use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};

use super::*;
use crate::{Hints, Severity, Survey};

/// A scope of 12.5 MS/s and 12 bits with 30 dB on both channels.
fn scope() -> Sensing {
    Sensing {
        rate: Rate::Hz(12.5e6),
        bits: 12,
        snr_db: Some(30.0),
        ..Sensing::default()
    }
}

fn settings(sensing: Sensing, seed: u64) -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Behavioural,
        pot: SimulatedPot::new(PotBase::Ferritic, 0.21),
        duration_s: 20e-3,
        sensing,
        seed,
        ..CaptureSpec::default()
    }
}

fn capture(settings: &CaptureSpec) -> Capture {
    record(settings, |_| ()).unwrap().capture("any load")
}

fn found(capture: &Capture) -> SelfCalibration {
    let survey = Survey::from_capture(capture, &Hints::default()).unwrap();
    estimate(capture, &survey, None).unwrap()
}

fn load(capture: &Capture) -> Load {
    let survey = Survey::from_capture(capture, &Hints::default()).unwrap();
    survey.spans[0].load.unwrap()
}

/// One pole, exact for a signal that is straight from sample to sample.
fn low_pass(x: &mut [f32], dt_s: f64, tau_s: f64) {
    let keep = (-dt_s / tau_s).exp();
    let now = 1.0 - tau_s / dt_s * (1.0 - keep);
    let mut y = f64::from(x[0]);
    let mut last = y;
    for x in x {
        let new = f64::from(*x);
        y = keep * y + (1.0 - keep - now) * last + now * new;
        last = new;
        *x = y as f32;
    }
}

/// High-pass, as the rest that a low-pass leaves.
fn high_pass(x: &mut [f32], corner_hz: f64) {
    let mut slow = x.to_vec();
    low_pass(&mut slow, DT_S, 1.0 / (TAU * corner_hz));
    x.iter_mut().zip(slow).for_each(|(x, slow)| *x -= slow);
}

const DT_S: f64 = 80e-9;

#[test]
fn a_skew_is_found_from_any_load_and_none_where_there_is_none() {
    for (rate_hz, skew_s) in [
        (12.5e6, 0.0),
        (12.5e6, 60e-9),
        (12.5e6, -60e-9),
        (12.5e6, 1e-6),
        (12.5e6, -1e-6),
        (50e6, 20e-9),
        (6.25e6, 37e-9),
    ] {
        let sensing = Sensing {
            rate: Rate::Hz(rate_hz),
            allow_aliasing: true,
            skew_s,
            ..scope()
        };
        let f = found(&capture(&settings(sensing, 1)));
        let error_s = f.lag_s.value + skew_s;
        assert!(error_s.abs() < 3.0 * f.lag_s.sigma, "{skew_s:e} {f:?}");
        assert!(f.lag_s.sigma < 3e-9 && f.is_sound(), "{f:?}");
        assert_eq!(f.is_significant(), skew_s != 0.0, "{f:?}");
        let off = f.capacitance_f.value / 1080e-9 - 1.0;
        assert!(off.abs() < 3e-3, "{f:?}");
    }
}

#[test]
fn the_deviation_told_is_that_of_many_seeds() {
    let seen: Vec<FittedValue> = (0..12)
        .map(|seed| {
            let sensing = Sensing {
                skew_s: 30e-9,
                ..scope()
            };
            let mut s = settings(sensing, 100 + seed);
            s.duration_s = 10e-3;
            found(&capture(&s)).lag_s
        })
        .collect();
    let n = seen.len() as f64;
    let shown = (seen.iter().map(|f| (f.value + 30e-9).powi(2)).sum::<f64>() / n).sqrt();
    let told = seen.iter().map(|f| f.sigma).sum::<f64>() / n;
    println!("{shown:e} {told:e}");
    // Twelve seeds know a deviation to some 20 %.
    assert!((0.55..1.8).contains(&(shown / told)), "{shown:e} {told:e}");
}

/// A filter of both channels changes neither R nor L, and its tails after the edges are no lag.
#[test]
fn a_filter_that_both_channels_share_is_no_lag() {
    for (pole_hz, f_sw_hz, rate_hz) in [
        (150e3, 45e3, 12.5e6),
        (200e3, 70e3, 20e6),
        (300e3, 70e3, 20e6),
        (500e3, 45e3, 12.5e6),
        (150e3, 45e3, 50e6),
        (200e3, 50e3, 12.5e6),
    ] {
        let mut all = settings(scope(), 3);
        all.sensing.snr_db = Some(50.0);
        (all.f_sw_hz, all.sensing.rate) = (f_sw_hz, Rate::Hz(rate_hz));
        let mut capture = capture(&all);
        let tau_s = 1.0 / (TAU * pole_hz);
        low_pass(&mut capture.v_v, 1.0 / rate_hz, tau_s);
        low_pass(&mut capture.i_a, 1.0 / rate_hz, tau_s);
        let found = found(&capture);
        println!(
            "{pole_hz} {f_sw_hz} {rate_hz}: {:?} {:?}",
            found.lag_s, found.cost_pct
        );
        let (r_pct, _) = found.cost_pct.unwrap();
        assert!(
            !found.is_significant() || r_pct < 0.2,
            "{pole_hz} {f_sw_hz} {rate_hz}: {found:?}"
        );
    }
}

#[test]
fn a_slow_current_probe_is_known_as_such_and_taken_out() {
    let clean = capture(&settings(scope(), 2));
    let truth = load(&clean);
    for (corner_hz, told_apart) in [(1e6, false), (100e3, true)] {
        let tau_s = 1.0 / (TAU * corner_hz);
        let mut slow = clean.clone();
        low_pass(&mut slow.i_a, DT_S, tau_s);
        let wrong = load(&slow);
        let f = found(&slow);
        println!("{corner_hz}: {f:?}");
        assert!((f.lag_s.value - tau_s).abs() < 4.0 * f.lag_s.sigma, "{f:?}");
        if told_apart {
            assert!(
                matches!(f.response, SensorResponse::SlowCurrent { .. }),
                "{f:?}"
            );
        }
        f.correction().unwrap().apply(&mut slow);
        let right = load(&slow);
        println!("{truth:?} {wrong:?} {right:?}");
        assert!((wrong.r_ohm / truth.r_ohm - 1.0).abs() > 0.05);
        assert!((right.r_ohm / truth.r_ohm - 1.0).abs() < 0.01, "{right:?}");
        assert!((right.l_h / truth.l_h - 1.0).abs() < 0.005, "{right:?}");
    }
}

#[test]
fn a_slow_voltage_probe_and_a_droop_are_taken_out_too() {
    let clean = capture(&settings(scope(), 3));
    let truth = load(&clean);
    let faults: [fn(&mut Capture); 3] = [
        |c| low_pass(&mut c.v_v, DT_S, 159e-9),
        |c| {
            high_pass(&mut c.i_a, 1e3);
        },
        |c| {
            high_pass(&mut c.i_a, 5e3);
        },
    ];
    for fault in faults {
        let mut faulty = clean.clone();
        fault(&mut faulty);
        let f = found(&faulty);
        println!("{f:?}");
        let correction = f.correction().expect("something to take out");
        let wrong = load(&faulty);
        correction.apply(&mut faulty);
        let right = load(&faulty);
        println!("{correction} {truth:?} {wrong:?} {right:?}");
        assert!((right.r_ohm / truth.r_ohm - 1.0).abs() < 0.01, "{right:?}");
        assert!((right.l_h / truth.l_h - 1.0).abs() < 0.005, "{right:?}");
    }
}

/// Its tails reach over half a plateau, and less noise shows more of them.
#[test]
fn a_very_slow_voltage_probe_is_no_skew() {
    for (corner_hz, snr_db) in [(200e3, 70.0), (300e3, 45.0), (500e3, 70.0)] {
        let sensing = Sensing {
            snr_db: Some(snr_db),
            ..scope()
        };
        let mut c = capture(&settings(sensing, 9));
        let truth = load(&c);
        low_pass(&mut c.v_v, DT_S, 1.0 / (TAU * corner_hz));
        let f = found(&c);
        assert!(
            matches!(f.response, SensorResponse::SlowVoltage { .. }),
            "{f:?}"
        );
        f.correction().unwrap().apply(&mut c);
        let right = load(&c);
        assert!((right.r_ohm / truth.r_ohm - 1.0).abs() < 0.01, "{right:?}");
        assert!((right.l_h / truth.l_h - 1.0).abs() < 0.005, "{right:?}");
    }
}

#[test]
fn a_skew_is_found_beside_a_filter_that_both_channels_share() {
    let sensing = Sensing {
        pole_hz: 150e3,
        skew_s: -100e-9,
        snr_db: Some(60.0),
        ..scope()
    };
    let f = found(&capture(&settings(sensing, 1)));
    let error_s = f.lag_s.value - 100e-9;
    assert!(error_s.abs() < 3.0 * f.lag_s.sigma, "{f:?}");
    assert!(f.lag_s.sigma < 20e-9 && f.is_sound(), "{f:?}");
}

#[test]
fn bus_ripple_dead_time_ringing_and_few_bits_do_not_hide_it() {
    let sensing = Sensing {
        skew_s: 37e-9,
        ringing: 0.1,
        ..scope()
    };
    let s = CaptureSpec {
        bus_capacitance_f: 5e-6,
        dead_s: 1e-6,
        ..settings(sensing, 4)
    };
    let f = found(&capture(&s));
    println!("{f:?}");
    assert!(
        (f.lag_s.value + 37e-9).abs() < 7e-9 && f.is_sound(),
        "{f:?}"
    );
    assert!(!f.tests.sides_agree, "{f:?}");
}

#[test]
fn a_saturating_sensor_is_warned_of_and_not_corrected() {
    let mut c = capture(&settings(scope(), 5));
    for i in &mut c.i_a {
        *i = 100.0 * (*i / 100.0).tanh();
    }
    let f = found(&c);
    println!("{f:?}");
    assert!(f.is_bent() && f.correction().is_none(), "{f:?}");
    let said = f.remarks(false);
    assert!(
        said.iter()
            .any(|r| r.code == "sensor_nonlinear" && r.severity == Severity::Warning)
    );
    // A lag is what a linear sensor would have: of this one it is no cause.
    let of_model = ["sensor_nonlinear", "plateaus_not_flat"];
    let mut warned = said.iter().filter(|r| r.severity > Severity::Info);
    assert!(warned.all(|r| of_model.contains(&r.code)), "{said:?}");
}

/// Few samples between edges make a limit of 1 % out of one of 0.4 %: the remark states the one that decided.
#[test]
fn a_remark_states_the_limit_that_was_exceeded() {
    let f = found(&capture(&settings(scope(), 5)));
    for (samples, limit_pct) in [(60.0, 0.4), (20.0, 1.0)] {
        let bend = FittedValue {
            value: 0.02,
            sigma: 1e-4,
        };
        let bent = SelfCalibration {
            samples,
            tests: ModelTests { bend, ..f.tests },
            ..f.clone()
        };
        let said = bent.remarks(false);
        let nonlinear = said.iter().find(|r| r.code == "sensor_nonlinear").unwrap();
        assert!((nonlinear.limit.unwrap() - limit_pct).abs() < 1e-9);
    }
}

/// The correction assumes tanh; of another curve with the same cubic term it leaves what its deviation says.
#[test]
fn a_saturation_is_taken_out_to_its_deviation() {
    let clean = capture(&settings(scope(), 5));
    let truth = load(&clean);
    let curves: [fn(f64) -> f64; 2] = [f64::tanh, |x| {
        // x − x³/3 + …, as tanh.
        x.atan()
    }];
    for curve in curves {
        let mut bent = clean.clone();
        for i in &mut bent.i_a {
            *i = (120.0 * curve(f64::from(*i) / 120.0)) as f32;
        }
        let found = calibrate(&bent, &Hints::default(), BlindOptions::default()).unwrap();
        let saturation = found.saturation.unwrap();
        let right = load(&found.capture);
        let off = (right.l_h / truth.l_h - 1.0).abs();
        let before = (load(&bent).l_h / truth.l_h - 1.0).abs();
        println!("{saturation:?} {off:e} {before:e}");
        assert!(before > 8.0 * off, "{off:e} {before:e}");
        assert!(off < 3.0 * saturation.left, "{off:e} {saturation:?}");
        let said = found.remarks();
        assert!(said.iter().any(|r| r.code == "sensor_nonlinear"));
    }
}

#[test]
fn steps_of_a_few_bits_are_not_taken_for_a_lag() {
    let mut few = capture(&settings(
        Sensing {
            snr_db: None,
            ..scope()
        },
        9,
    ));
    for (x, step) in [(&mut few.v_v, 20.0), (&mut few.i_a, 4.0)] {
        x.iter_mut().for_each(|x| *x = (*x / step).round() * step);
    }
    let survey = Survey::from_capture(&few, &Hints::default()).unwrap();
    let e = estimate(&few, &survey, None).unwrap_err();
    assert!(matches!(e, BlindError::TooCoarse { .. }), "{e:?}");
    assert_eq!(e.remark().severity, Severity::Info);
}

#[test]
fn a_gain_shows_against_a_known_capacitor_alone() {
    let sensing = Sensing {
        v_gain: 1.03,
        ..scope()
    };
    let c = capture(&settings(sensing, 6));
    let survey = Survey::from_capture(&c, &Hints::default()).unwrap();
    let code = |known| {
        let f = estimate(&c, &survey, known).unwrap();
        let remark = f.remarks(false).pop().unwrap();
        (remark.code, remark.severity, remark.value.unwrap())
    };
    let (name, severity, off) = code(Some(1080e-9));
    assert_eq!((name, severity), ("gain", Severity::Warning));
    assert!((off - 3.0).abs() < 0.3, "{off}");
    let (name, severity, _) = code(None);
    assert_eq!((name, severity), ("gain_unknown", Severity::Info));
    assert_eq!(code(Some(1080e-9 / 1.03)).0, "gain_right");
}

/// A probe's factor of 10 that nobody stated leaves L of 2 µH, which a hob may have; its capacitor of 10.8 µF is none.
#[test]
fn a_capacitor_that_no_hob_has_is_a_probes_factor() {
    for (v, i) in [(0.1, 1.0), (10.0, 1.0), (1.0, 0.01)] {
        let mut c = capture(&settings(scope(), 6));
        (c.v_full_scale_v, c.i_full_scale_a) = (None, None);
        c.v_v.iter_mut().for_each(|x| *x *= v);
        c.i_a.iter_mut().for_each(|x| *x *= i);
        let survey = Survey::from_capture(&c, &Hints::default()).unwrap();
        let found = estimate(&c, &survey, None).unwrap();
        let remark = found.remarks(false).pop().unwrap();
        assert_eq!(
            (remark.code, remark.severity),
            ("gain_unknown", Severity::Warning),
            "{v} {i}: {remark}"
        );
    }
}

#[test]
fn what_has_no_plateaus_is_not_judged() {
    let c = capture(&settings(scope(), 7));
    // A generator of sines.
    let mut sine = c.clone();
    for (k, (v, i)) in sine.v_v.iter_mut().zip(&mut sine.i_a).enumerate() {
        let angle = TAU * 45e3 * k as f64 * DT_S;
        let noise = f64::from(*v).sin();
        *v = (290.0 * angle.sin() + noise) as f32;
        *i = (40.0 * (angle - 1.0).sin()) as f32;
    }
    let survey = Survey::from_capture(&sine, &Hints::default()).unwrap();
    let e = estimate(&sine, &survey, None).unwrap_err();
    assert_eq!(e, BlindError::NoEdges);
    assert_eq!(e.remark().severity, Severity::Info);
}

#[test]
fn the_bridges_voltage_in_place_of_the_coils_is_noticed() {
    let mut c = capture(&settings(scope(), 8));
    // Add the capacitor's voltage.
    let mut q_c = 0.0;
    let mean = c.i_a.iter().map(|i| f64::from(*i)).sum::<f64>() / c.len() as f64;
    for (v, i) in c.v_v.iter_mut().zip(&c.i_a) {
        q_c += (f64::from(*i) - mean) * DT_S;
        *v += (q_c / 1080e-9) as f32;
    }
    let survey = Survey::from_capture(&c, &Hints::default()).unwrap();
    let e = estimate(&c, &survey, None);
    assert_eq!(e, Err(BlindError::BridgeVoltage));
}

/// A window of a board: one half-cycle at 61 samples in three periods, both channels through 500 kHz.
fn window(skew_s: f64, snr_db: Option<f64>, seed: u64) -> Segment {
    let sensing = Sensing {
        rate: Rate::Locked,
        pole_hz: 500e3,
        bits: 12,
        skew_s,
        snr_db,
        ..Sensing::default()
    };
    let mut s = settings(sensing, seed);
    s.duration_s = 10e-3;
    let c = capture(&s);
    let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect();
    Segment {
        f_sw_hz: s.f_sw_hz,
        mains_hz: 50.0,
        zero_crossing_s: 0.0,
        t0_s: 0.0,
        dt_s: 3.0 / (61.0 * s.f_sw_hz),
        v_v: wide(&c.v_v),
        i_a: wide(&c.i_a),
    }
}

#[test]
fn a_window_of_a_board_knows_a_skew_to_some_nanoseconds() {
    let filter_s = 1.0 / (TAU * 500e3);
    for (snr_db, most_s) in [(Some(30.0), 25e-9), (Some(50.0), 4e-9), (None, 3e-9)] {
        for skew_s in [0.0, 30e-9] {
            let seen: Vec<_> = (0..3)
                .map(|seed| {
                    estimate_segment(
                        &window(skew_s, snr_db, 200 + seed),
                        None,
                        None,
                        Some(filter_s),
                    )
                })
                .map(|f| f.unwrap())
                .collect();
            let n = seen.len() as f64;
            let lags: Vec<f64> = seen.iter().map(|f| -f.as_skew_s.value).collect();
            let mean = lags.iter().sum::<f64>() / n;
            let spread = lags.iter().map(|l| (l - mean).powi(2)).sum::<f64>();
            let told = seen.iter().map(|f| f.lag_s.sigma).sum::<f64>() / n;
            let sound = seen.iter().filter(|f| f.is_sound()).count();
            println!(
                "{snr_db:?} skew {:.0} ns: lag {:.2} ns, spread {:.2} ns, told {:.2} ns, sound {sound}, C {:.1} nF, {:.1} samples of {}",
                skew_s * 1e9,
                mean * 1e9,
                (spread / (n - 1.0)).sqrt() * 1e9,
                told * 1e9,
                seen[0].capacitance_f.value * 1e9,
                seen[0].samples,
                seen[0].plateaus
            );
            assert!(told < most_s, "{told:e}");
            let error_s = (mean + skew_s).abs();
            assert!(error_s < 3.0 * told / n.sqrt() + 3e-9, "{mean:e} {told:e}");
        }
    }
}
