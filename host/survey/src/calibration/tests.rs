//! Calibration against the simulator's sensing chain, whose settings are the truth.

use ihd_sim::behavioural::{BehaviouralLoad, PotKind};
use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

use super::*;
use crate::{Hints, Survey};

/// A chain with errors, at 12.5 MS/s and 12 bits.
fn chain(snr_db: Option<f64>) -> Sensing {
    Sensing {
        rate: Rate::Hz(12.5e6),
        bits: 12,
        v_gain: 1.02,
        i_gain: 0.99,
        v_offset_v: 4.0,
        i_offset_a: -0.7,
        skew_s: 37e-9,
        snr_db,
        ..Sensing::default()
    }
}

fn settings(pot: SimulatedPot, sensing: Sensing, seed: u64) -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Behavioural,
        pot,
        duration_s: 10e-3,
        sensing,
        seed,
        ..CaptureSpec::default()
    }
}

fn capture(settings: &CaptureSpec) -> Capture {
    record(settings, |_| ()).unwrap().capture("reference")
}

fn calibrated(capture: &Capture, reference: ReferenceLoad) -> Result<Calibration, CalibrateError> {
    let survey = Survey::from_capture(capture, &Hints::default()).unwrap();
    estimate(capture, &survey, reference)
}

const EMPTY: ReferenceLoad = ReferenceLoad::NoPot {
    r_ohm: None,
    l_h: None,
};

#[test]
fn the_empty_coil_gives_skew_and_offsets_and_with_its_l_the_gains() {
    let c = capture(&settings(SimulatedPot::NONE, chain(Some(50.0)), 1));
    let found = calibrated(&c, EMPTY).unwrap();
    let error_s = (found.skew_s - 37e-9).abs();
    assert!(error_s < 1.5e-9, "{found:?}");
    assert!(
        error_s < 2.0 * found.skew_sigma_s && found.skew_sigma_s < 2e-9,
        "{found:?}"
    );
    assert_eq!((found.gain_ratio, found.gain_ratio_sigma), (1.0, 0.0));
    assert!((found.v_offset_v - 4.0).abs() < 0.2, "{found:?}");
    assert!((found.i_offset_a + 0.7).abs() < 0.1, "{found:?}");

    // R and L as the simulator has them.
    let (r_ohm, l_h) = BehaviouralLoad::new(PotKind::None, 45e3).r_l(0.0);
    let known = ReferenceLoad::NoPot {
        r_ohm: Some(r_ohm),
        l_h: Some(l_h),
    };
    let found = calibrated(&c, known).unwrap();
    assert!((found.skew_s - 37e-9).abs() < 0.7e-9, "{found:?}");
    let ratio = 1.02 / 0.99;
    assert!((found.gain_ratio / ratio - 1.0).abs() < 1e-3, "{found:?}");
}

#[test]
fn frequency_steps_tell_the_coils_r_from_a_skew_too() {
    // No harmonic but the fundamental: 10 samples a period show the third alone, a little.
    let mut s = settings(SimulatedPot::NONE, chain(Some(60.0)), 2);
    s.duration_s = 20e-3;
    s.events = vec![RecordingEvent {
        t_s: 10e-3,
        change: RecordingChange::Frequency(75e3),
    }];
    let found = calibrated(&capture(&s), EMPTY).unwrap();
    assert!(
        (found.skew_s - 37e-9).abs() < 2.0 * found.skew_sigma_s,
        "{found:?}"
    );
    assert!((found.skew_s - 37e-9).abs() < 1.5e-9, "{found:?}");
}

#[test]
fn a_known_load_gives_skew_and_gains() {
    let pot = SimulatedPot::new(PotBase::Stainless, 0.21);
    let (r_ohm, l_h) = BehaviouralLoad::new(PotKind::Stainless, 45e3).r_l(0.0);
    let mut s = settings(pot, chain(Some(50.0)), 3);
    (s.sensing.v_full_scale_v, s.sensing.i_full_scale_a) = (800.0, 400.0);
    let both = ReferenceLoad::Load {
        r_ohm: Some(r_ohm),
        l_h: Some(l_h),
    };
    let found = calibrated(&capture(&s), both).unwrap();
    assert!((found.skew_s - 37e-9).abs() < 0.5e-9, "{found:?}");
    assert!(
        (found.gain_ratio / (1.02 / 0.99) - 1.0).abs() < 1e-3,
        "{found:?}"
    );
    // R alone: the gains have to be right.
    (s.sensing.v_gain, s.sensing.i_gain) = (1.0, 1.0);
    let r_only = ReferenceLoad::Load {
        r_ohm: Some(r_ohm),
        l_h: None,
    };
    let found = calibrated(&capture(&s), r_only).unwrap();
    assert!((found.skew_s - 37e-9).abs() < 1e-9, "{found:?}");
}

#[test]
fn the_deviation_reported_is_that_of_many_seeds() {
    let pot = SimulatedPot::new(PotBase::Stainless, 0.21);
    let (r_ohm, l_h) = BehaviouralLoad::new(PotKind::Stainless, 45e3).r_l(0.0);
    let both = ReferenceLoad::Load {
        r_ohm: Some(r_ohm),
        l_h: Some(l_h),
    };
    let mut skews = Vec::new();
    let mut reported = 0.0;
    for seed in 0..16 {
        let mut s = settings(pot, chain(Some(30.0)), 100 + seed);
        s.duration_s = 2e-3;
        s.start_s = 4e-3;
        (s.sensing.v_full_scale_v, s.sensing.i_full_scale_a) = (800.0, 400.0);
        let found = calibrated(&capture(&s), both).unwrap();
        skews.push(found.skew_s);
        reported = found.skew_sigma_s;
    }
    let n = skews.len() as f64;
    let mean = skews.iter().sum::<f64>() / n;
    let shown = (skews.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    // 16 seeds know a deviation to some 18 %.
    assert!(
        (0.5..2.0).contains(&(reported / shown)),
        "reported {reported:e} s, shown {shown:e} s"
    );
    assert!((mean - 37e-9).abs() < 1e-9, "{mean:e}");
}

#[test]
fn applied_it_takes_the_error_out_of_another_capture() {
    let pot = SimulatedPot::new(PotBase::Ferritic, 0.21);
    // The board's filter: without it aliasing is 0.1 % of the voltage, 4 ns of its phase.
    for (rate, pole_hz) in [(Rate::Hz(12.5e6), 0.0), (Rate::Locked, 500e3)] {
        let with = |sensing: Sensing| {
            let sensing = Sensing {
                rate,
                pole_hz,
                ..sensing
            };
            let c = capture(&settings(pot, sensing, 5));
            let z = Survey::from_capture(&c, &Hints::default()).unwrap().spans[0]
                .load
                .unwrap();
            (c, z)
        };
        let (_, truth) = with(Sensing::default());
        let (mut c, wrong) = with(chain(None));
        assert!((wrong.r_ohm / truth.r_ohm - 1.0).abs() > 0.02);
        let (r_ohm, l_h) = BehaviouralLoad::new(PotKind::None, 45e3).r_l(0.0);
        let known = ReferenceLoad::NoPot {
            r_ohm: Some(r_ohm),
            l_h: Some(l_h),
        };
        let empty = Sensing {
            rate,
            pole_hz,
            ..chain(None)
        };
        let found = calibrated(&capture(&settings(SimulatedPot::NONE, empty, 6)), known).unwrap();
        found.apply(&mut c);
        let survey = Survey::from_capture(&c, &Hints::default()).unwrap();
        let right = survey.spans[0].load.unwrap();
        assert!(
            (right.r_ohm / truth.r_ohm - 1.0).abs() < 2e-3,
            "{right:?} {truth:?} {found:?}"
        );
        assert!(
            (right.l_h / truth.l_h - 1.0).abs() < 1e-3,
            "{right:?} {truth:?}"
        );
        assert!(survey.voltage.mean.abs() < 0.1 && survey.current.mean.abs() < 0.1);
    }
}

/// A capacitor of 1 % is known to 0.5 %, and the ratio of the gains with it. A capacitance of 1.25 times the true one makes the ratio
/// 1.25: its deviation is the ratio's own, of which [`Calibration::apply`] states the share.
#[test]
fn the_gains_by_a_capacitor_are_no_more_certain_than_that_capacitor() {
    let sensing = Sensing {
        v_gain: 1.0,
        i_gain: 1.0,
        v_offset_v: 0.0,
        i_offset_a: 0.0,
        ..chain(Some(50.0))
    };
    let mut c = capture(&settings(
        SimulatedPot::new(PotBase::Ferritic, 0.21),
        sensing,
        4,
    ));
    let survey = Survey::from_capture(&c, &Hints::default()).unwrap();
    let alone = blind::estimate(&c, &survey, None).unwrap().capacitance_f;
    let sensors = blind::estimate(&c, &survey, Some(1.25 * alone.value)).unwrap();
    let found = Calibration::from_self_calibration(&sensors, &survey);
    let share = 5e-3f64.hypot(alone.sigma / alone.value);
    assert!((found.gain_ratio - 1.25).abs() < 1e-9, "{found:?}");
    assert!(
        (found.gain_ratio_sigma / (1.25 * share) - 1.0).abs() < 1e-9,
        "{found:?}"
    );
    found.apply(&mut c);
    let [_, gain] = sigma_of(&c).unwrap();
    assert!((gain / share - 1.0).abs() < 1e-9, "{gain}");
    // A ratio that is known to a factor of three has that deviation, and is not certain.
    let vague = Calibration {
        gain_ratio_sigma: 2.0 * found.gain_ratio,
        ..found
    };
    vague.apply(&mut c);
    assert_eq!(sigma_of(&c).map(|[_, gain]| gain), Some(2.0));
}

#[test]
fn files_come_back_and_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let c = Calibration {
        skew_s: 37.25e-9,
        skew_sigma_s: 1e-10,
        gain_ratio: 1.0303,
        gain_ratio_sigma: 1e-4,
        v_offset_v: 4.0,
        i_offset_a: -0.7,
        response: Correction {
            i_tau_s: 1.25e-7,
            ..Correction::default()
        },
        reference: "no-pot".to_owned(),
        assumed: vec!["right gains".to_owned()],
        capture: "empty.csv".to_owned(),
        contradictions: Vec::new(),
    };
    for name in ["a.toml", "a.json", "a"] {
        let path = dir.path().join(name);
        c.write(&path).unwrap();
        assert_eq!(Calibration::read(&path).unwrap(), c);
        for content in ["", "{}", "skew_s = 1", "\u{0}"] {
            std::fs::write(&path, content).unwrap();
            let e = Calibration::read(&path).unwrap_err().to_string();
            assert!(e.contains(name) && e.contains("ihd calibrate"), "{e}");
        }
        for wrong in [f64::NAN, 1.0] {
            let c = Calibration {
                skew_s: wrong,
                ..c.clone()
            };
            let older = std::fs::read(&path).unwrap();
            let refused = c.write(&path).unwrap_err().to_string();
            assert!(refused.contains("skew_s is"), "{refused}");
            assert_eq!(std::fs::read(&path).unwrap(), older);
            let text = match name {
                "a.json" => serde_json::to_string(&c).unwrap(),
                _ => toml::to_string(&c).unwrap(),
            };
            std::fs::write(&path, text).unwrap();
            assert!(Calibration::read(&path).is_err());
        }
    }
    assert!(Calibration::read(&dir.path().join("none.toml")).is_err());
}

#[test]
fn what_gives_no_calibration_is_refused_with_the_reason() {
    let pot = SimulatedPot::new(PotBase::Ferritic, 0.21);
    let heated = capture(&settings(pot, chain(None), 7));
    let e = calibrated(&heated, EMPTY).unwrap_err();
    assert!(matches!(e, CalibrateError::NotTheReference { .. }), "{e}");
    let small = ReferenceLoad::Load {
        r_ohm: None,
        l_h: Some(80e-6),
    };
    let e = calibrated(&heated, small).unwrap_err();
    assert!(matches!(e, CalibrateError::NotTheReference { .. }), "{e}");
    let mut swapped = heated.clone();
    std::mem::swap(&mut swapped.v_v, &mut swapped.i_a);
    (swapped.v_full_scale_v, swapped.i_full_scale_a) = (None, None);
    let e = calibrated(&swapped, EMPTY).unwrap_err();
    assert!(matches!(e, CalibrateError::Unfit { .. }), "{e}");
}

/// A pot whose R falls by a third with the current has no R to calibrate against, whatever R is stated.
#[test]
fn a_load_that_goes_with_the_current_is_no_reference() {
    let pot = capture(&settings(
        SimulatedPot::new(PotBase::Ferritic, 0.21),
        Sensing::default(),
        7,
    ));
    let stated = ReferenceLoad::Load {
        r_ohm: Some(3.3),
        l_h: Some(25e-6),
    };
    let refused = calibrated(&pot, stated).unwrap_err();
    assert!(
        matches!(&refused, CalibrateError::NotTheReference { what, .. } if what.contains("at small")),
        "{refused}"
    );
}

/// A current probe of 100 kHz on the empty coil shows a delay that changes with frequency.
#[test]
fn a_probe_with_too_little_bandwidth_contradicts_itself() {
    let mut c = capture(&settings(SimulatedPot::NONE, chain(Some(60.0)), 4));
    assert_eq!(
        calibrated(&c, EMPTY).unwrap().doubts(),
        Vec::<String>::new()
    );
    // One pole: y' = 2π 100 kHz (x − y), at 12.5 MS/s.
    let share = 1.0 - (-std::f64::consts::TAU * 100e3 / 12.5e6).exp();
    let mut y = 0.0;
    for i in &mut c.i_a {
        y += share * (f64::from(*i) - y);
        *i = y as f32;
    }
    match calibrated(&c, EMPTY) {
        Ok(found) => assert!(
            found.doubts().iter().any(|d| d.contains("bandwidth")),
            "{found:?}"
        ),
        Err(refused) => panic!("{refused}"),
    }
}

#[test]
fn what_cannot_be_told_from_none_and_what_another_file_denies_is_doubted() {
    let known = Calibration {
        skew_s: 37e-9,
        skew_sigma_s: 0.5e-9,
        gain_ratio: 1.0,
        gain_ratio_sigma: 0.0,
        v_offset_v: 0.0,
        i_offset_a: 0.0,
        response: Correction::default(),
        reference: "no-pot".into(),
        assumed: Vec::new(),
        capture: "a".into(),
        contradictions: Vec::new(),
    };
    assert_eq!(known.doubts(), Vec::<String>::new());
    // A reference of 20 mH for 20 µH, a probe's factor of 10 that nobody told.
    for (skew_s, gain_ratio, word) in [
        (1.166e-6, 1.0, "1166 ns"),
        (-1.166e-6, 1.0, "1166 ns"),
        (37e-9, 10.0, "10.0000"),
        (37e-9, 0.85362, "0.8536"),
        (37e-9, 0.1, "0.1000"),
    ] {
        let odd = Calibration {
            skew_s,
            gain_ratio,
            ..known.clone()
        };
        assert!(odd.doubts()[0].contains(word), "{:?}", odd.doubts());
    }
    let vague = Calibration {
        skew_s: 3e-9,
        skew_sigma_s: 20e-9,
        ..known.clone()
    };
    assert!(vague.doubts()[0].contains("3.0 ± 20.0 ns"), "{vague:?}");
    let other = Calibration {
        skew_s: 60e-9,
        ..known.clone()
    };
    let said = other.contradicts(&known);
    assert!(
        said.len() == 1 && said[0].contains("37.00 ± 0.50 ns, now 60.00"),
        "{said:?}"
    );
    let near = Calibration {
        skew_s: 38e-9,
        ..known.clone()
    };
    assert_eq!(near.contradicts(&known), Vec::<String>::new());
    assert_eq!(vague.contradicts(&known), Vec::<String>::new());
}
