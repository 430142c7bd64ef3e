//! Captures that tell wrong things, or nothing.

use super::*;

#[test]
fn what_was_told_wrongly_is_told_back() {
    let mut s = settings(45e3, 20e-3);
    s.sensing.rate = Rate::Locked;
    let mut c = capture(&s);
    c.f_sw = vec![crate::capture::FrequencyStep {
        t_s: 0.0,
        f_sw_hz: 50e3,
    }];
    let differs = |f: &Finding| matches!(f, Finding::FrequencyDiffers { .. });
    assert!(survey(&c).findings.iter().any(differs));
    let hints = Hints {
        f_sw_hz: Some(60e3),
        ..Hints::default()
    };
    let refused = Survey::of(&c, &hints).unwrap_err();
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
    let refused = |c: &Capture| Survey::of(c, &Hints::default()).unwrap_err();
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
    assert!(matches!(refused(&c), SurveyError::TooShort { .. }));
}
