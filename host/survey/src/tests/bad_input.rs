//! Captures that state wrong things, or nothing.

use super::*;

#[test]
fn what_was_specified_wrongly_is_reported() {
    let mut s = settings(45e3, 20e-3);
    s.sensing.rate = Rate::Locked;
    let mut c = capture(&s);
    c.f_sw = vec![ihd_signal::FrequencyStep {
        t_s: 0.0,
        f_sw_hz: 50e3,
    }];
    let differs = |f: &Finding| matches!(f, Finding::FrequencyDiffers { .. });
    assert!(survey(&c).findings.iter().any(differs));
    let hints = Hints {
        f_sw_hz: Some(60e3),
        ..Hints::default()
    };
    let refused = Survey::from_capture(&c, &hints).unwrap_err();
    assert!(
        matches!(refused, SurveyError::NotAtHint { .. }),
        "{refused:?}"
    );
    let text = refused.to_string();
    assert!(
        text.contains("60.00 kHz") && text.contains("45.00 kHz"),
        "{text}"
    );
}

#[test]
fn captures_with_nothing_in_them_are_refused_with_the_reason() {
    use rand::{RngExt, SeedableRng};
    let s = settings(45e3, 1e-3);
    let good = capture(&s);
    let refused = |c: &Capture| Survey::from_capture(c, &Hints::default()).unwrap_err();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    for n in [1_000, 30_000] {
        let noise: Vec<f32> = (0..n).map(|_| rng.random::<f32>() - 0.5).collect();
        let mut c = good.clone();
        (c.v_v, c.i_a) = (noise.clone(), noise.iter().rev().copied().collect());
        c.time = TimeBase::Even {
            t0_s: 0.0,
            dt_s: 1e-6,
        };
        assert!(matches!(refused(&c), SurveyError::NoCarrier { .. }), "{n}");
    }
    let mut c = good.clone();
    c.v_v.truncate(2000);
    assert!(matches!(refused(&c), SurveyError::Lengths { v: 2000, .. }));
    c.i_a.truncate(2000);
    assert!(matches!(refused(&c), SurveyError::TooShort { .. }));
    c.time = TimeBase::Even {
        t0_s: 0.0,
        dt_s: f64::NAN,
    };
    assert!(matches!(refused(&c), SurveyError::TimeStep { .. }));
    c.time = TimeBase::Even {
        t0_s: 0.0,
        dt_s: 1e-3,
    };
    assert!(matches!(refused(&c), SurveyError::TooSlow { .. }));
    (c.v_v, c.i_a) = (Vec::new(), Vec::new());
    c.time = TimeBase::Stamps(Vec::new());
    assert!(matches!(refused(&c), SurveyError::Empty { .. }));
}

/// Found by fuzzing: relative errors of an L of zero were infinite.
#[test]
fn both_probes_on_one_wire_give_finite_numbers() {
    let mut c = capture(&settings(45e3, 5e-3));
    c.i_a.clone_from(&c.v_v);
    let survey = survey(&c);
    assert_eq!(survey.skew, []);
    let text = format!("{survey:?}");
    assert!(!text.contains(" inf") && !text.contains("NaN"), "{text}");
}

/// Found by fuzzing: where noise hides the carrier now and then, stretches shared samples.
#[test]
fn spans_of_a_carrier_in_noise_do_not_overlap() {
    use rand::{RngExt, SeedableRng};
    let mut c = capture(&settings(45e3, 1e-3));
    let dt_s = 1.0 / 216e3;
    for seed in 0..10 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut sample = |k: usize, lag: f64| {
            let t_s = k as f64 * dt_s;
            let bus = (std::f64::consts::TAU * 59.0 * t_s).sin().abs();
            let noise = 2.2 * rng.random_range(-1.0..1.0);
            (40.0 * bus * ((std::f64::consts::TAU * 89e3 * t_s - lag).cos() + noise)) as f32
        };
        c.v_v = (0..18_000).map(|k| sample(k, 0.0)).collect();
        c.i_a = (0..18_000).map(|k| sample(k, 1.0)).collect();
        c.time = TimeBase::Even { t0_s: 0.0, dt_s };
        let Ok(survey) = Survey::from_capture(&c, &Hints::default()) else {
            continue;
        };
        for pair in survey.spans.windows(2) {
            assert!(pair[0].first + pair[0].samples <= pair[1].first, "{seed}");
        }
        // Found by fuzzing too: the phase of noise made them negative.
        assert!(survey.spans.iter().all(|s| s.f_sw_hz > 0.0), "{seed}");
    }
}

/// Found by fuzzing: steps told out of order made stretches share samples.
#[test]
fn steps_in_any_order_do_not_make_spans_overlap() {
    let mut c = capture(&settings(45e3, 20e-3));
    let step = |t_s| ihd_signal::FrequencyStep { t_s, f_sw_hz: 45e3 };
    c.f_sw = [0.0, 12e-3, 6e-3].map(step).to_vec();
    let spans = survey(&c).spans;
    assert!(spans.len() > 1);
    for pair in spans.windows(2) {
        assert!(pair[0].first + pair[0].samples <= pair[1].first);
    }
}

#[test]
fn the_order_in_which_steps_are_stated_does_not_matter() {
    let mut s = settings(45e3, 20e-3);
    s.events = vec![RecordingEvent {
        t_s: 10e-3,
        change: RecordingChange::Frequency(50e3),
    }];
    let mut c = capture(&s);
    c.f_sw = [(0.0, 45e3), (10e-3, 50e3)]
        .map(|(t_s, f_sw_hz)| ihd_signal::FrequencyStep { t_s, f_sw_hz })
        .to_vec();
    let in_order = survey(&c);
    let differs = |f: &Finding| matches!(f, Finding::FrequencyDiffers { .. });
    assert!(!in_order.findings.iter().any(differs));
    c.f_sw.reverse();
    assert_eq!(survey(&c), in_order);
}

/// Found by fuzzing: steps of time that are infinite.
#[test]
fn stamps_at_the_ends_of_what_a_number_holds_are_refused() {
    let mut c = capture(&settings(45e3, 5e-3));
    // Each of the steps between them is infinite.
    let ends = [-1.7e308, 1.7e308];
    c.time = TimeBase::Stamps((0..c.len()).map(|k| ends[k % 2]).collect());
    assert!(Survey::from_capture(&c, &Hints::default()).is_err());
}

/// Found by fuzzing: a panic where the first stretch has two samples.
#[test]
fn two_stamped_samples_before_a_hole_are_passed_over() {
    let mut c = capture(&settings(45e3, 5e-3));
    c.v_v[2] = f32::NAN;
    let t_s = (0..c.len()).map(|k| c.time.at(k).unwrap());
    c.time = TimeBase::Stamps(t_s.collect());
    assert_eq!(survey(&c).spans[0].first, 3);
}

/// Found by fuzzing: frequencies and times that are no numbers.
#[test]
fn a_start_beyond_the_digits_of_time_is_refused() {
    let mut c = capture(&settings(45e3, 5e-3));
    for t0_s in [-1.7e308, 1e300, 1e12] {
        c.time = TimeBase::Even { t0_s, dt_s: 1e-6 };
        let refused = Survey::from_capture(&c, &Hints::default());
        assert!(matches!(refused, Err(SurveyError::TimeStep { .. })));
    }
}

/// Found by fuzzing: a duration that is no number.
#[test]
fn a_first_or_last_stamp_that_is_no_number_is_passed_over() {
    let mut c = capture(&settings(45e3, 5e-3));
    let mut t_s: Vec<f64> = (0..c.len()).map(|k| c.time.at(k).unwrap()).collect();
    let duration_s = t_s[c.len() - 2] - t_s[1];
    t_s[0] = f64::NAN;
    t_s[c.len() - 1] = f64::INFINITY;
    c.time = TimeBase::Stamps(t_s);
    assert!((survey(&c).duration_s - duration_s).abs() < 1e-9);
}

/// Found by fuzzing: half-cycles without length.
#[test]
fn half_cycles_last() {
    let hints = Hints {
        mains_hz: Some(1e19),
        ..Hints::default()
    };
    let survey = Survey::from_capture(&capture(&settings(45e3, 5e-3)), &hints).unwrap();
    assert!(
        survey
            .half_cycles_s
            .iter()
            .all(|(from_s, to_s)| from_s < to_s)
    );
}

/// Any samples and times: a survey of finite numbers, or a typed error.
#[test]
fn whatever_comes_in_nothing_panics_and_numbers_stay_finite() {
    use rand::{RngExt, SeedableRng};
    let mut s = settings(45e3, 4e-3);
    s.sensing.rate = Rate::Locked;
    let good = capture(&s);
    let TimeBase::Stamps(stamps) = &good.time else {
        panic!("locked captures have stamps")
    };
    let (mut surveyed, mut refused) = (0, 0);
    for seed in 0..150 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut c = good.clone();
        let mut t_s = stamps.clone();
        let scale = 10f32.powi(rng.random_range(-30..37));
        for _ in 0..rng.random_range(0..6) {
            let at = rng.random_range(0..c.len());
            let length = rng.random_range(1..400).min(c.len() - at);
            match rng.random_range(0..8) {
                0 => c.v_v[at..at + length].fill(f32::NAN),
                1 => c.i_a[at..at + length].fill(0.0),
                2 => c.i_a[at] = f32::MAX,
                3 => t_s[at..].iter_mut().for_each(|t| *t += 1e9),
                4 => t_s[at] = f64::NAN,
                5 => t_s[at..].iter_mut().for_each(|t| *t -= 1e-3),
                6 => c.v_v.iter_mut().for_each(|v| *v *= scale),
                _ => t_s[at..].iter_mut().for_each(|t| *t *= 1.0 + 1e-3),
            }
        }
        let even = rng.random_range(0..4) == 0;
        c.time = if even {
            let dt_s = 10f64.powi(rng.random_range(-320..10));
            TimeBase::Even { t0_s: 1e3, dt_s }
        } else {
            TimeBase::Stamps(t_s)
        };
        let hints = Hints {
            f_sw_hz: [None, Some(45e3), Some(f64::NAN), Some(-1.0), Some(1e-9)][seed as usize % 5],
            mains_hz: [None, Some(0.0), Some(f64::INFINITY)][seed as usize % 3],
            zero_crossing_s: [None, Some(f64::NAN)][seed as usize % 2],
            ..Hints::default()
        };
        match Survey::from_capture(&c, &hints) {
            Ok(survey) => {
                surveyed += 1;
                for span in &survey.spans {
                    assert!(
                        span.f_sw_hz.is_finite() && span.dt_s > 0.0,
                        "{seed}: {span:?}"
                    );
                    assert!(span.first + span.samples <= c.len(), "{seed}: {span:?}");
                    let segment = survey.segment(&c, span);
                    let finite = |x: &[f64]| x.iter().all(|x| x.is_finite());
                    assert!(finite(&segment.v_v) && finite(&segment.i_a), "{seed}");
                }
                assert!(survey.mains.hz.is_finite() && survey.mains.zero_crossing_s.is_finite());
                assert!(survey.voltage.rms.is_finite() && survey.current.rms.is_finite());
            }
            Err(e) => {
                refused += 1;
                assert!(e.to_string().starts_with("simulated: "), "{e}");
            }
        }
    }
    assert!(surveyed > 20 && refused > 20, "{surveyed} {refused}");
}
