//! Gate on simulated captures: right results pass without a warning, wrong ones are refused or warned of.

use std::f64::consts::TAU;

use ihd_gate::{
    Evidence, Examination, ExamineOptions, MethodResult, Reconstruct, ReferenceResults, Verdict,
    examine, judge,
};
use ihd_identify::accuracy::Accuracy;
use ihd_identify::pooled::SharedSigma;
use ihd_identify::{Estimate, IdentifyOptions as Methods, Method, Preprocessing};
use ihd_signal::{Capture, Remark, Segment, Severity};
use ihd_sim::recording::sensing::{Rate, Sensing};
use ihd_sim::recording::settings::{CaptureSpec, Neighbour, RecordingChange, RecordingEvent};
use ihd_survey::Hints;
use ihd_survey::calibration::blind::BlindOptions;
use ihd_survey::calibration::{Calibration, Correction};

mod simulated;

use simulated::{capture, clean};

fn examined(capture: &Capture, methods: &[Method]) -> Examination {
    let request = ExamineOptions {
        hints: Hints::default(),
        methods,
        sensors: BlindOptions::default(),
        settings: &Methods::default(),
        reconstruct: Reconstruct::No,
    };
    examine(capture, &request, &mut |_, _, _| ()).expect("a carrier")
}

fn codes(outcome: &MethodResult) -> Vec<&'static str> {
    outcome.judgement.doubts().map(|d| d.code).collect()
}

#[test]
fn what_is_right_passes_without_a_word() {
    let locked = Sensing {
        rate: Rate::Locked,
        bits: 12,
        pole_hz: 500e3,
        ..Sensing::default()
    };
    let with_noise = |snr_db| Sensing {
        snr_db: Some(snr_db),
        ..clean().sensing
    };
    for settings in [
        clean(),
        CaptureSpec {
            duty: 0.35,
            ..clean()
        },
        CaptureSpec {
            sensing: locked,
            ..clean()
        },
        CaptureSpec {
            sensing: with_noise(30.0),
            ..clean()
        },
        CaptureSpec {
            sensing: with_noise(20.0),
            ..clean()
        },
    ] {
        let capture = capture(&settings);
        let examined = examined(&capture, &[Method::LeastSquares, Method::Lockin]);
        assert_eq!(examined.outcomes.len(), 2);
        for outcome in &examined.outcomes {
            let verdict = outcome.judgement.gate.verdict;
            let said = &outcome.judgement.findings;
            assert_eq!(verdict, Verdict::Pass, "{:?}: {said:?}", settings.sensing);
            assert_eq!(codes(outcome), [""; 0], "{:?}: {said:?}", settings.sensing);
        }
    }
}

/// A probe's factor that nobody stated: ten is warned of, more is refused.
#[test]
fn a_factor_that_was_not_stated_is_not_silent() {
    for (v, i, verdict) in [
        (0.1, 1.0, Verdict::Pass),
        (10.0, 1.0, Verdict::Pass),
        (1.0, 0.01, Verdict::Refuse),
        (1e-3, 1.0, Verdict::Refuse),
    ] {
        let mut capture = capture(&clean());
        (capture.v_full_scale_v, capture.i_full_scale_a) = (None, None);
        capture.v_v.iter_mut().for_each(|x| *x *= v);
        capture.i_a.iter_mut().for_each(|x| *x *= i);
        let examined = examined(&capture, &[Method::LeastSquares]);
        let gate = &examined.outcomes[0].judgement.gate;
        assert_eq!(gate.verdict, verdict, "v × {v}, i × {i}: {gate}");
        let said = examined
            .sensors_to_report()
            .chain(&examined.outcomes[0].judgement.findings);
        let warned = said.filter(|f| f.severity >= Severity::Warning);
        assert!(warned.count() > 0, "v × {v}, i × {i}");
    }
}

/// An error of more than 1 % of R or .7 % of L (middle 80 %) is never silent, whatever made it.
#[test]
fn what_is_wrong_is_not_silent() {
    let step = |t_s, r_factor, l_factor| RecordingEvent {
        t_s,
        change: RecordingChange::Load { r_factor, l_factor },
    };
    let tone = |offset_hz, v| Some(Neighbour { offset_hz, v });
    let twenty_db = Sensing {
        snr_db: Some(20.0),
        ..clean().sensing
    };
    let methods = [Method::LeastSquares, Method::Lockin, Method::Kf];
    let mut wrong = 0;
    for settings in [
        CaptureSpec {
            neighbour: tone(1.2e3, 8.0),
            ..clean()
        },
        CaptureSpec {
            neighbour: tone(-830.0, 4.0),
            ..clean()
        },
        CaptureSpec {
            events: vec![step(5e-3, 3.0, 1.0), step(5.3e-3, 1.0, 1.0)],
            ..clean()
        },
        CaptureSpec {
            sensing: twenty_db,
            ..clean()
        },
    ] {
        let capture = capture(&settings);
        let examined = examined(&capture, &methods);
        for outcome in &examined.outcomes {
            let segment = &examined.segments[outcome.segment];
            let found = outcome.result.as_ref().expect("an estimate");
            let accuracy = Accuracy::measure(found, segment, &capture.truth, f64::NEG_INFINITY);
            // A stretch may lie between two of the truth's points.
            let Some(Accuracy { middle: errors, .. }) = accuracy else {
                continue;
            };
            if settings.neighbour.is_some() {
                let said = codes(outcome).contains(&"interference");
                let right = errors.r_pct < 1.0 && errors.l_pct < 0.7;
                assert!(said && right, "{}: {errors:?}", outcome.method);
            }
            if errors.r_pct > 1.0 || errors.l_pct > 0.7 {
                wrong += 1;
                let doubts = outcome.judgement.doubts().count();
                assert!(doubts > 0, "{} is off by {errors:?}", outcome.method);
            }
        }
    }
    assert!(wrong >= 1, "no result is wrong at all");
}

/// A capture seldom ends with a half-cycle: what was captured of the next one is left out, and its verdict says so.
#[test]
fn a_stub_at_an_end_is_left_out() {
    for (start_ms, duration_ms) in [(0.0, 21.5), (0.0, 13.0), (8.2, 12.5), (0.0, 22.5)] {
        let mut settings = clean();
        settings.start_s = start_ms * 1e-3;
        settings.duration_s = duration_ms * 1e-3;
        settings.sensing.snr_db = Some(20.0);
        let examined = examined(&capture(&settings), &[Method::LeastSquares]);
        let [outcome] = &examined.outcomes[..] else {
            panic!("{} outcomes", examined.outcomes.len());
        };
        let judgement = &outcome.judgement;
        assert_eq!(judgement.gate.why, [""; 0], "{duration_ms} ms");
        let (whole, stubs): (Vec<_>, Vec<_>) =
            judgement.half_cycles.iter().partition(|h| h.seen >= 0.5);
        assert!(!whole.is_empty() && !stubs.is_empty(), "{judgement:?}");
        assert!(whole.iter().all(|h| h.gate.passes()), "{whole:?}");
        for stub in stubs {
            assert_eq!(stub.gate.verdict, Verdict::CannotTell);
            assert!(stub.gate.why[0].contains("middle"), "{stub:?}");
        }
    }
}

/// A capture of a millisecond or two gives, with noise, neither R nor its deviation: no verdict is better than a wrong one.
#[test]
fn of_a_capture_too_short_the_gate_cannot_tell() {
    for (start_ms, duration_ms) in [(0.2, 0.9), (9.0, 0.9), (9.6, 1.0)] {
        let mut settings = clean();
        settings.start_s = start_ms * 1e-3;
        settings.duration_s = duration_ms * 1e-3;
        settings.sensing.snr_db = Some(20.0);
        let examined = examined(&capture(&settings), &[Method::LeastSquares]);
        for outcome in &examined.outcomes {
            let gate = &outcome.judgement.gate;
            assert_eq!(gate.verdict, Verdict::CannotTell, "{start_ms} ms: {gate}");
        }
    }
}

/// Errors in variables: noise on the current's derivative biases the linear filter's L towards zero.
#[test]
fn the_linear_filter_is_refused_in_noise_and_least_squares_is_not() {
    let mut settings = clean();
    settings.sensing.snr_db = Some(20.0);
    let examined = examined(&capture(&settings), &[Method::Kf, Method::LeastSquares]);
    let [kf, least_squares] = &examined.outcomes[..] else {
        panic!("{} outcomes", examined.outcomes.len());
    };
    assert!(!kf.judgement.gate.passes());
    // The filter's σ contains the difference, so that this warning refuses nothing by itself.
    let differs = kf.judgement.findings.iter();
    let mut differs = differs.filter(|f| f.code == "disagreement");
    assert_eq!(differs.next().map(|f| f.severity), Some(Severity::Warning));
    // The samples are good enough for least squares: a longer capture would not help the filter.
    let of_kf = kf.judgement.findings.iter();
    let uncertain = of_kf.filter(|f| f.code == "uncertain").collect::<Vec<_>>();
    assert!(
        !uncertain.is_empty()
            && uncertain
                .iter()
                .all(|f| f.text.contains("use least-squares"))
    );
    assert!(least_squares.judgement.gate.passes());
}

/// A tone costs what it is strong enough for, and nothing where the fit does not follow it.
#[test]
fn a_tone_is_judged_by_what_it_costs() {
    let severity = |offset_hz: f64, v: f64| {
        let settings = CaptureSpec {
            neighbour: Some(Neighbour { offset_hz, v }),
            ..clean()
        };
        let examined = examined(&capture(&settings), &[Method::LeastSquares]);
        let findings = examined.outcomes.iter().flat_map(|o| &o.judgement.findings);
        findings
            .filter(|f| f.code == "interference")
            .map(|f| f.severity)
            .max()
    };
    // It is removed, but not without a word.
    assert_eq!(severity(1.2e3, 8.0), Some(Severity::Warning));
    assert_eq!(severity(1.2e3, 0.02), None);
    assert_eq!(severity(20e3, 8.0), None);
}

/// A chain that is known to 20 ns and 2 % leaves R and L no better known, however clean the samples, and however many half-cycles.
#[test]
fn deviations_of_a_calibration_are_in_those_of_r_and_l() {
    let (skew_sigma_s, gain_ratio_sigma) = (20e-9, 0.02);
    let examined = examined_with_calibration(skew_sigma_s, gain_ratio_sigma);
    assert_eq!(codes(&examined.outcomes[0]), [""; 0]);
    let found = examined.outcomes[0].result.as_ref().expect("an estimate");
    let law = examined.pooled[0].as_ref().expect("two half-cycles");
    let (crest, last) = (found.r_ohm.len() / 4, law.r_ohm.len() - 1);
    let omega = TAU * found.f_sw_hz;
    for (r_ohm, l_h, sigma) in [
        (
            found.r_ohm[crest],
            found.l_h[crest],
            found.r_sigma_ohm[crest],
        ),
        (law.r_ohm[last], law.l_h[last], law.r_sigma_ohm[last]),
    ] {
        let least = (gain_ratio_sigma * r_ohm).hypot(omega * omega * l_h * skew_sigma_s);
        assert!((0.999..1.1).contains(&(sigma / least)), "{sigma} {least}");
    }
}

#[test]
fn a_calibration_that_leaves_five_percent_is_refused_as_noise_of_five_percent_is() {
    let examined = examined_with_calibration(0.0, 0.05);
    let judgement = &examined.outcomes[0].judgement;
    assert!(!judgement.gate.passes());
    let doubt = judgement
        .doubts()
        .find(|d| d.code == "uncertain")
        .expect("5 %");
    assert!(doubt.text.contains("the sensors leave"), "{}", doubt.text);
    assert!(
        doubt.value.is_some_and(|pct| (5.0..5.2).contains(&pct)),
        "{doubt:?}"
    );
    assert!(examined.pooled[0].is_some(), "σ is stated with the law");
}

fn examined_with_calibration(skew_sigma_s: f64, gain_ratio_sigma: f64) -> Examination {
    let mut calibrated = capture(&clean());
    let calibration = Calibration {
        skew_s: 0.0,
        skew_sigma_s,
        gain_ratio: 1.0,
        gain_ratio_sigma,
        v_offset_v: 0.0,
        i_offset_a: 0.0,
        response: Correction::default(),
        reference: "r=3".to_owned(),
        assumed: Vec::new(),
        capture: "another".to_owned(),
        contradictions: Vec::new(),
    };
    calibration.apply(&mut calibrated);
    examined(&calibrated, &[Method::LeastSquares])
}

/// Two half-cycles through 18 µH and a resistance of 3 Ω that swings by a fifth at `swing_hz`.
fn swinging(swing_hz: f64) -> Segment {
    let (dt_s, mains, omega) = (80e-9, TAU * 50.0, TAU * 45e3);
    let (mut v_v, mut i_a) = (Vec::new(), Vec::new());
    for k in 0..250_000 {
        let t = f64::from(k) * dt_s;
        let envelope = 40.0 * (mains * t).sin().abs();
        let slope = 40.0 * mains * (mains * t).cos() * (mains * t).sin().signum();
        let (sin, cos) = (omega * t).sin_cos();
        let r_ohm = 3.0 + 0.6 * (TAU * swing_hz * t).sin();
        v_v.push(r_ohm * envelope * cos + 18e-6 * (slope * cos - envelope * omega * sin));
        i_a.push(envelope * cos);
    }
    Segment {
        f_sw_hz: 45e3,
        mains_hz: 50.0,
        zero_crossing_s: 0.0,
        t0_s: 0.0,
        dt_s,
        v_v: v_v.into(),
        i_a: i_a.into(),
    }
}

#[test]
fn a_load_that_least_squares_does_not_follow_is_unconfirmed() {
    let codes = |swing_hz: f64| -> Vec<&str> {
        let segment = swinging(swing_hz);
        let reference = ReferenceResults::compute(&segment, &Preprocessing::new(&segment), None);
        let judgement = judge(&Evidence {
            remarks: &[],
            segment: &segment,
            estimate: reference.least_squares.as_ref().expect("a carrier"),
            reference: &reference,
            shared: SharedSigma::default(),
        });
        judgement.doubts().map(|d| d.code).collect()
    };
    assert_eq!(codes(0.0), [""; 0]);
    assert!(codes(4e3).contains(&"unconfirmed"), "{:?}", codes(4e3));
}

/// Half a millisecond after a crossing holds no middle of a half-cycle, whether the method states σ or not. Least squares agrees with nothing
/// there, so that a training that did not converge stays an error.
#[test]
fn a_stretch_without_a_middle_is_too_short_by_a_method_without_deviations_too() {
    let whole = swinging(0.0);
    let segment = whole.part(0, whole.index_at(0.5e-3));
    let reference = ReferenceResults::compute(&segment, &Preprocessing::new(&segment), None);
    let mut estimate = Estimate::new(Method::Pinn, segment.f_sw_hz);
    (estimate.t_s, estimate.r_ohm, estimate.l_h) = (vec![0.25e-3], vec![3.0], vec![18e-6]);
    let unsettled = Remark::new("not_converged", Severity::Error, "a limit of steps");
    estimate.remarks.push(unsettled.clone());
    let judgement = judge(&Evidence {
        remarks: &[],
        segment: &segment,
        estimate: &estimate,
        reference: &reference,
        shared: SharedSigma::default(),
    });
    assert!(judgement.doubts().any(|d| d.code == "too_short"));
    assert!(judgement.findings.contains(&unsettled));
}
