use super::super::settings::{CarrierSweep, LoadKind, Neighbour, RecordingEvent};
use super::*;
use crate::behavioural;
use crate::behavioural::PotKind;
use crate::pot::SimulatedPot;
use ihd_field::model::FieldSettings;
use ihd_field::{FieldModel, harmonic};

fn behavioural(duration_s: f64) -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Behavioural,
        duration_s,
        ..CaptureSpec::default()
    }
}

#[test]
fn truth_of_the_behavioural_load_is_its_law() {
    let r = record(&behavioural(10e-3), |_| ()).unwrap();
    assert_eq!(r.v_code.len(), 500_000);
    let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
    let mut compared = 0;
    for t in r.truth.iter().filter(|t| t.i_a > 2.0) {
        // The law sees the envelope of the past period: half a period late.
        let (r_ohm, l_h) = law.r_l(t.i_a);
        assert!((t.r_ohm[0] / r_ohm - 1.0).abs() < 0.02, "{t:?} {r_ohm}");
        assert!((t.l_h[0] / l_h - 1.0).abs() < 0.02, "{t:?} {l_h}");
        compared += 1;
    }
    assert!(compared > 350);
}

#[test]
fn the_same_seed_gives_the_same_record_and_another_does_not() {
    let mut s = behavioural(1e-3);
    s.sensing.snr_db = Some(30.0);
    let a = record(&s, |_| ()).unwrap();
    assert_eq!(a, record(&s, |_| ()).unwrap());
    s.seed = 2;
    assert_ne!(a.v_code, record(&s, |_| ()).unwrap().v_code);
}

#[test]
fn events_change_frequency_pot_and_bridge() {
    let mut s = behavioural(10e-3);
    s.events = vec![
        RecordingEvent {
            t_s: 3e-3,
            change: RecordingChange::Frequency(60e3),
        },
        RecordingEvent {
            t_s: 5e-3,
            change: RecordingChange::Pot(SimulatedPot::NONE),
        },
        RecordingEvent {
            t_s: 7e-3,
            change: RecordingChange::Off,
        },
    ];
    let r = record(&s, |_| ()).unwrap();
    let at = |t_s: f64| r.truth.iter().find(|t| t.t_s > t_s).unwrap();
    assert_eq!(at(2e-3).f_sw_hz, 45e3);
    assert_eq!(at(4e-3).f_sw_hz, 60e3);
    assert!(
        (at(6e-3).l_h[0] / 50.5e-6 - 1.0).abs() < 0.02,
        "{:?}",
        at(6e-3)
    );
    assert!(at(9e-3).i_a < 0.2 * at(6.9e-3).i_a);
}

#[test]
fn taking_the_pot_off_the_field_model_leaves_the_bare_coil() {
    let mut s = CaptureSpec {
        duration_s: 4e-3,
        ..CaptureSpec::default()
    };
    s.events = vec![
        RecordingEvent {
            t_s: 2e-3,
            change: RecordingChange::Frequency(50e3),
        },
        RecordingEvent {
            t_s: 3e-3,
            change: RecordingChange::Pot(SimulatedPot::NONE),
        },
    ];
    let r = record(&s, |_| ()).unwrap();
    let before = r.truth.iter().rfind(|t| t.t_s < 2.9e-3).unwrap();
    let after = r.truth.last().unwrap();
    let bare = FieldModel::bare_coil(&FieldSettings::paper()).unwrap();
    let bare = harmonic::impedance(&bare, 50e3, 1.0).unwrap().l_h;
    assert!(before.l_h[0] < 30e-6, "{before:?}");
    assert!((after.l_h[0] / bare - 1.0).abs() < 0.01, "{after:?} {bare}");
    assert!(after.r_ohm[0].abs() < 0.2);
    // No step of the current at the exchange.
    let jump = r
        .i_clean_a
        .windows(2)
        .map(|w| (w[1] - w[0]).abs())
        .fold(0.0, f64::max);
    assert!(jump < 2.0, "{jump}");
}

#[test]
fn dead_time_is_invisible_to_lagging_current() {
    let a = record(&behavioural(3e-3), |_| ()).unwrap();
    let b = record(
        &CaptureSpec {
            dead_s: 1e-6,
            ..behavioural(3e-3)
        },
        |_| (),
    )
    .unwrap();
    let (x, y) = (a.truth.last().unwrap(), b.truth.last().unwrap());
    assert!((x.i_a / y.i_a - 1.0).abs() < 0.01, "{x:?} {y:?}");
}

#[test]
fn a_bus_capacitor_keeps_current_flowing_at_the_zero_crossing() {
    let with = |bus_capacitance_f| {
        let s = CaptureSpec {
            bus_capacitance_f,
            f_sw_hz: 70e3,
            ..behavioural(10.5e-3)
        };
        let r = record(&s, |_| ()).unwrap();
        r.truth.iter().rfind(|t| t.t_s < 10e-3).unwrap().i_a
    };
    let (without, small, large) = (with(0.0), with(5e-6), with(50e-6));
    assert!(
        without < 0.2 && small > without && large > 3.0,
        "{without} {small} {large}"
    );
}

/// Every period has its own frequency, and the law's R and L there.
#[test]
fn a_swept_carrier_has_its_frequency_and_load_in_every_period() {
    let s = CaptureSpec {
        sweep: Some(CarrierSweep {
            deviation_hz: 3e3,
            rate_hz: 500.0,
        }),
        ..behavioural(10e-3)
    };
    let r = record(&s, |_| ()).unwrap();
    let mut from_s = 0.0;
    for t in r.truth.windows(2) {
        // Truth stands at the boundary between two periods, with the mean of both frequencies.
        assert!((t[1].f_sw_hz - s.swept_hz(45e3, t[1].t_s)).abs() < 300.0);
        assert!(t[1].t_s > from_s);
        from_s = t[1].t_s;
        if t[1].i_a > 5.0 {
            let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, t[1].f_sw_hz);
            let (r_ohm, l_h) = law.r_l(t[1].i_a);
            assert!((t[1].r_ohm[0] / r_ohm - 1.0).abs() < 0.02, "{t:?} {r_ohm}");
            assert!((t[1].l_h[0] / l_h - 1.0).abs() < 0.01, "{t:?} {l_h}");
        }
    }
    let reached = |f: fn(f64, f64) -> f64, from| r.truth.iter().map(|t| t.f_sw_hz).fold(from, f);
    assert!((reached(f64::max, 0.0) - 48e3).abs() < 50.0);
    assert!((reached(f64::min, 1e6) - 42e3).abs() < 50.0);
    // The sweep's mean is the carrier's: so many periods fit.
    assert!(r.truth.len().abs_diff(450) <= 1, "{}", r.truth.len());
    assert!(r.capture("swept").f_sw.is_empty());
}

/// Between edges the node stands at the bus less r·i: the plateau v + ∫i/C shows r, R and L do not.
#[test]
fn the_bridges_resistance_is_no_part_of_the_coil() {
    let with = |bridge_r_ohm| {
        let s = CaptureSpec {
            bridge_r_ohm,
            start_s: 3e-3,
            ..behavioural(4e-3)
        };
        record(&s, |_| ()).unwrap()
    };
    let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
    let r_ohm = 0.2;
    let bridged = with(r_ohm);
    for t in bridged.truth.iter().skip(20) {
        assert!((t.r_ohm[0] / law.r_l(t.i_a).0 - 1.0).abs() < 0.01, "{t:?}");
    }
    // The lower switch's plateau: from 0.6 to 0.9 of every period the node is at −r i.
    let (mut charge_c, mut cross, mut square) = (0.0, 0.0, 0.0);
    let dt_s = 20e-9;
    for k in 1..bridged.t_s.len() {
        charge_c += 0.5 * (bridged.i_clean_a[k] + bridged.i_clean_a[k - 1]) * dt_s;
        if (0.6..0.9).contains(&(bridged.t_s[k] * 45e3).fract()) {
            let node_v = bridged.v_clean_v[k] + charge_c / 1080e-9;
            cross += node_v * bridged.i_clean_a[k];
            square += bridged.i_clean_a[k].powi(2);
        }
    }
    assert!(
        (-cross / square / r_ohm - 1.0).abs() < 0.02,
        "{}",
        -cross / square
    );
}

/// The part of the coil's voltage that R and L leave is the neighbour's tone, in amplitude and frequency.
#[test]
fn a_neighbour_is_what_r_and_l_leave_unexplained() {
    let s = CaptureSpec {
        load: LoadKind::Behavioural,
        pot: SimulatedPot::NONE,
        start_s: 2e-3,
        duration_s: 5e-3,
        neighbour: Some(Neighbour {
            offset_hz: 1.2e3,
            v: 8.0,
        }),
        ..CaptureSpec::default()
    };
    let r = record(&s, |_| ()).unwrap();
    let law = behavioural::BehaviouralLoad::new(PotKind::None, 45e3);
    let (r_ohm, l_h) = law.r_l(1.0);
    let truth = &r.truth[100];
    assert!((truth.r_ohm[0] / r_ohm - 1.0).abs() < 1e-2, "{truth:?}");
    assert!((truth.l_h[0] / l_h - 1.0).abs() < 1e-3, "{truth:?}");
    let dt_s = 20e-9;
    let (mut re, mut im, mut n) = (0.0, 0.0, 0.0);
    for k in 1..r.t_s.len() - 1 {
        let slope = (r.i_clean_a[k + 1] - r.i_clean_a[k - 1]) / (2.0 * dt_s);
        let left_v = r.v_clean_v[k] - r_ohm * r.i_clean_a[k] - l_h * slope;
        let angle = std::f64::consts::TAU * 46.2e3 * (r.t_s[k] + s.start_s);
        (re, im, n) = (
            re + left_v * angle.sin(),
            im + left_v * angle.cos(),
            n + 1.0,
        );
    }
    let (re, im) = (2.0 * re / n, 2.0 * im / n);
    assert!((re / 8.0 - 1.0).abs() < 0.02 && im.abs() < 0.2, "{re} {im}");
}

#[test]
fn a_load_step_scales_the_law_until_the_next() {
    let step = |t_s, r_factor, l_factor| RecordingEvent {
        t_s,
        change: RecordingChange::Load { r_factor, l_factor },
    };
    let s = CaptureSpec {
        events: vec![step(4e-3, 0.6, 1.35), step(6e-3, 1.0, 1.0)],
        ..behavioural(8e-3)
    };
    let r = record(&s, |_| ()).unwrap();
    let law = behavioural::BehaviouralLoad::new(PotKind::Ferromagnetic, 45e3);
    for (from_s, to_s, r_factor, l_factor) in [
        (3e-3, 3.9e-3, 1.0, 1.0),
        (4.3e-3, 5.9e-3, 0.6, 1.35),
        (6.3e-3, 7.9e-3, 1.0, 1.0),
    ] {
        for t in r.truth.iter().filter(|t| (from_s..to_s).contains(&t.t_s)) {
            let (r_ohm, l_h) = law.r_l(t.i_a);
            assert!(
                (t.r_ohm[0] / (r_factor * r_ohm) - 1.0).abs() < 0.01,
                "{t:?}"
            );
            assert!((t.l_h[0] / (l_factor * l_h) - 1.0).abs() < 0.01, "{t:?}");
        }
    }
}

#[test]
fn another_seed_is_another_noise_on_the_same_waveform() {
    let mut s = behavioural(1e-3);
    s.sensing.snr_db = Some(30.0);
    let first = record(&s, |_| ()).unwrap();
    let again = first.with_seed(2);
    assert!(again.v_clean_v == first.v_clean_v && again.truth == first.truth);
    let noise_a = |r: &SimulatedRecording| -> Vec<f64> {
        let seen = r.i_code.iter().map(|c| f64::from(*c) * r.ampere_per_code());
        seen.zip(&r.i_clean_a).map(|(y, x)| y - x).collect()
    };
    let (a, b) = (noise_a(&first), noise_a(&again));
    let power = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    assert!((power(&a, &b) / power(&a, &a)).abs() < 0.03, "uncorrelated");
    s.seed = 2;
    assert!(again == record(&s, |_| ()).unwrap());
}

#[test]
fn a_mains_of_47_hertz_has_its_zero_crossings_there() {
    let s = CaptureSpec {
        mains_hz: 47.0,
        ..behavioural(22e-3)
    };
    let r = record(&s, |_| ()).unwrap();
    for crossing_s in [0.5 / 47.0, 1.0 / 47.0] {
        let least = (r.truth.iter().filter(|t| (t.t_s - crossing_s).abs() < 1e-3))
            .min_by(|a, b| a.i_a.total_cmp(&b.i_a))
            .unwrap();
        assert!((least.t_s - crossing_s).abs() < 0.1e-3, "{least:?}");
    }
}

#[test]
fn a_distorted_mains_has_a_flatter_crest() {
    let at_crest = |mains_harmonics| {
        let s = CaptureSpec {
            mains_harmonics,
            ..behavioural(5.2e-3)
        };
        let r = record(&s, |_| ()).unwrap();
        r.truth.iter().rfind(|t| t.t_s < 5e-3).unwrap().i_a
    };
    // 5 % of third harmonic take 5 % off the crest; the load is nonlinear, so about that.
    let ratio = at_crest([0.05, 0.0, 0.0]) / at_crest([0.0; 3]);
    assert!((0.90..0.98).contains(&ratio), "{ratio}");
}
