//! Against captures of the simulator that are damaged here, so that the truth is known.

use ihd_identify::accuracy::Accuracy;
use ihd_identify::{IdentifyOptions, Method};
use ihd_signal::{Severity, TimeBase};
use ihd_sim::recording::settings::{CaptureSpec, RecordingChange, RecordingEvent};
use ihd_survey::calibration::blind::BlindOptions;

use self::simulated::{capture, clean};
use super::*;
use crate::{Examination, ExamineOptions, Reconstruct, examine};

#[path = "../../tests/simulated/mod.rs"]
mod simulated;

fn examined(capture: &Capture, hints: Hints, capacitance_f: Option<f64>) -> Examination {
    let request = ExamineOptions {
        hints,
        methods: &[Method::LeastSquares],
        sensors: BlindOptions {
            capacitance_f,
            ..BlindOptions::default()
        },
        settings: &IdentifyOptions::default(),
        reconstruct: Reconstruct::No,
    };
    examine(capture, &request, &mut |_, _, _| ()).unwrap()
}

/// Codes of the warnings on the capture and its sensors.
fn warned(examined: &Examination) -> Vec<&'static str> {
    let seen = examined.sensors.iter();
    seen.filter(|r| r.severity >= Severity::Warning)
        .map(|r| r.code)
        .collect()
}

/// Worst errors of R and L in percent; all pass.
fn errors_pct(examined: &Examination, truth: &Capture) -> [f64; 2] {
    let mut worst = [0.0f64; 2];
    for outcome in &examined.outcomes {
        assert!(outcome.judgement.gate.passes(), "{:?}", outcome.judgement);
        let segment = &examined.segments[outcome.segment];
        let found = outcome.result.as_ref().unwrap();
        let of = Accuracy::measure(found, segment, &truth.truth, f64::NEG_INFINITY);
        if let Some(Accuracy { middle, .. }) = of {
            worst = [worst[0].max(middle.r_pct), worst[1].max(middle.l_pct)];
        }
    }
    worst
}

fn exchange(capture: &mut Capture) {
    std::mem::swap(&mut capture.v_v, &mut capture.i_a);
    std::mem::swap(&mut capture.v_full_scale_v, &mut capture.i_full_scale_a);
}

#[test]
fn wrong_wiring_is_corrected_with_a_warning() {
    let right = capture(&clean());
    let clean = errors_pct(&examined(&right, Hints::default(), None), &right);
    for (swapped, reversed) in [
        (true, [1.0, 1.0]),
        (false, [1.0, -1.0]),
        (false, [-1.0, 1.0]),
        (true, [1.0, -1.0]),
    ] {
        let mut wrong = right.clone();
        for (x, sign) in [&mut wrong.v_v, &mut wrong.i_a].into_iter().zip(reversed) {
            x.iter_mut().for_each(|x| *x *= sign);
        }
        if swapped {
            exchange(&mut wrong);
        }
        let found = examined(&wrong, Hints::default(), None);
        let code = if swapped { "swapped" } else { "inverted" };
        assert_eq!(warned(&found), [code]);
        let pct = errors_pct(&found, &right);
        for (pct, clean) in pct.into_iter().zip(clean) {
            assert!(
                (pct - clean).abs() < 1e-3,
                "{swapped} {reversed:?}: {pct} {clean}"
            );
        }
    }
}

/// The user's word is not turned round: what contradicts it stays an error.
#[test]
fn what_contradicts_the_users_wiring_is_refused() {
    let right = capture(&clean());
    for swapped in [true, false] {
        // The importer has exchanged or reversed the channels by now.
        let mut wrong = right.clone();
        match swapped {
            true => exchange(&mut wrong),
            false => wrong.i_a.iter_mut().for_each(|i| *i = -*i),
        }
        let hints = Hints {
            swapped,
            inverted: !swapped,
            ..Hints::default()
        };
        let found = examined(&wrong, hints, None);
        assert!(found.outcomes.iter().all(|o| !o.judgement.gate.passes()));
        assert!(warned(&found).is_empty());
    }
}

#[test]
fn spikes_cost_nothing_and_ringing_is_none() {
    let mut wrong = capture(&clean());
    let n = wrong.len();
    // At the current's crest, each ten periods, so that they add up in the fundamental.
    let crests = (0..n).step_by(2778).map(|k| {
        let near = k..(k + 278).min(n);
        near.max_by(|a, b| wrong.i_a[*a].total_cmp(&wrong.i_a[*b]))
            .unwrap()
    });
    let crests: Vec<usize> = crests.filter(|k| *k > 10 && *k < n - 10).collect();
    for k in &crests {
        wrong.i_a[*k] += 60.0;
    }
    let found = examined(&wrong, Hints::default(), None);
    assert_eq!(warned(&found), ["spikes"]);
    let of_spikes = found.sensors.iter().find(|r| r.code == "spikes").unwrap();
    assert_eq!(of_spikes.value, Some(crests.len() as f64));
    let pct = errors_pct(&found, &wrong);
    assert!(pct[0] < 0.3 && pct[1] < 0.2, "{pct:?}");

    let mut ringing = clean();
    ringing.sensing.ringing = 0.3;
    let found = examined(&capture(&ringing), Hints::default(), None);
    assert!(!warned(&found).contains(&"spikes"));
}

/// Time of the last sample.
fn last_s(capture: &Capture) -> f64 {
    match &capture.time {
        TimeBase::Even { t0_s, dt_s } => t0_s + (capture.len() - 1) as f64 * dt_s,
        TimeBase::Stamps(t_s) => t_s[t_s.len() - 1],
    }
}

/// Deleted samples turn both phases by 2π·f·n·dt; a changed L turns the current alone, and a changed frequency bends both.
#[test]
fn samples_missing_without_a_mark_are_stamped_and_steps_are_not() {
    let whole = capture(&clean());
    let dt_s = 1.0 / 12.5e6;
    for missing in [40, 100, 230] {
        let mut wrong = whole.clone();
        // Near a crest, 5.2 ms from the start.
        let from = (5.2e-3 / dt_s) as usize;
        wrong.v_v.drain(from..from + missing);
        wrong.i_a.drain(from..from + missing);
        let found = repair(Cow::Borrowed(&wrong), &Hints::default()).unwrap();
        let [remark] = &found.remarks[..] else {
            panic!("{missing}: {:?}", found.remarks);
        };
        assert_eq!(
            (remark.code, remark.severity),
            ("phase_step", Severity::Warning)
        );
        let counted = remark.value.unwrap();
        assert!(
            (counted - missing as f64).abs() < 4.0,
            "{missing}: {counted}"
        );
        // What comes after the gap has its own time again.
        let last_s = last_s(&found.capture);
        let expected_s = self::last_s(&whole);
        assert!(
            (last_s - expected_s).abs() < 4.0 * dt_s,
            "{last_s} {expected_s}"
        );
    }
    let event = |change| {
        vec![RecordingEvent {
            t_s: 5.2e-3,
            change,
        }]
    };
    for events in [
        Vec::new(),
        event(RecordingChange::Load {
            r_factor: 1.4,
            l_factor: 1.2,
        }),
        event(RecordingChange::Frequency(46e3)),
    ] {
        let sound = capture(&CaptureSpec { events, ..clean() });
        let found = repair(Cow::Borrowed(&sound), &Hints::default()).unwrap();
        assert_eq!(found.remarks, []);
    }
    // Below resonance the phases bend steeply where the current is small.
    let low = capture(&CaptureSpec {
        f_sw_hz: 20e3,
        ..clean()
    });
    let found = repair(Cow::Borrowed(&low), &Hints::default()).unwrap();
    assert_eq!(found.remarks, []);
}

/// Gains that differ by 3 % make R and L 3 % wrong, which nothing shows but a capacitance that is known.
#[test]
fn a_known_capacitance_corrects_the_ratio_of_the_gains() {
    let mut off = clean();
    off.sensing.v_gain = 1.03;
    let wrong = capture(&off);
    let found = examined(&wrong, Hints::default(), Some(1080e-9));
    assert_eq!(warned(&found), ["gain"]);
    let pct = errors_pct(&found, &wrong);
    assert!(pct[0] < 0.5 && pct[1] < 0.5, "{pct:?}");
    let unknown = examined(&wrong, Hints::default(), None);
    let pct = errors_pct(&unknown, &wrong);
    assert!(pct[0] > 2.5 && pct[1] > 2.5, "{pct:?}");
    // More is no tolerance: the probe's factor or the capacitance is wrong.
    off.sensing.v_gain = 1.3;
    let found = examined(&capture(&off), Hints::default(), Some(1080e-9));
    let gain = found.sensors.iter().find(|r| r.code == "gain").unwrap();
    assert_eq!(
        (gain.severity, gain.limit),
        (Severity::Error, Some(20.0)),
        "{}",
        gain.text
    );
    assert!(found.outcomes.iter().all(|o| !o.judgement.gate.passes()));
}

/// Largest magnitude of a channel.
fn largest(x: &[f32]) -> f32 {
    x.iter().fold(0.0, |a, x| a.max(x.abs()))
}

fn clip(x: &mut [f32], share: f32) {
    let rail = share * largest(x);
    x.iter_mut().for_each(|x| *x = x.clamp(-rail, rail));
}

#[test]
fn a_channel_that_clips_is_restored_with_a_warning() {
    let right = capture(&clean());
    for share in [0.75, 0.9] {
        for voltage in [false, true] {
            let mut wrong = right.clone();
            clip(
                if voltage {
                    &mut wrong.v_v
                } else {
                    &mut wrong.i_a
                },
                share,
            );
            let found = examined(&wrong, Hints::default(), None);
            assert_eq!(warned(&found), ["clipping"], "{share} {voltage}");
            let pct = errors_pct(&found, &right);
            assert!(pct[0] < 0.5 && pct[1] < 0.35, "{share} {voltage}: {pct:?}");
        }
    }
}

/// Nothing says what is beyond the rails where both channels clip, or no period lies within them.
#[test]
fn what_cannot_be_restored_stays_refused() {
    let right = capture(&clean());
    let mut both = right.clone();
    clip(&mut both.v_v, 0.8);
    clip(&mut both.i_a, 0.8);
    let mut most = right.clone();
    clip(&mut most.i_a, 0.05);
    for wrong in [both, most] {
        let found = examined(&wrong, Hints::default(), None);
        assert!(found.outcomes.iter().all(|o| !o.judgement.gate.passes()));
    }
}
