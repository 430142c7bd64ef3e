//! The survey of any capture: a hob's, damaged at will.
//!
//! What must hold:
//! - it ends, within libFuzzer's time limit, with a survey or an error that says why;
//! - every number of a survey is finite, those of its findings too;
//! - spans lie within the capture, in order, and ascend in time; half-cycles lie within the capture;
//! - a span's segment has its samples, all finite; where it passes its own check, its half-cycles cover it.

#![cfg_attr(fuzzing, no_main)]

mod reader;

use std::f64::consts::TAU;

use ihd_signal::{Capture, FrequencyStep, TimeBase};
use ihd_survey::{Finding, Hints, Survey};
use reader::Reader;

/// Most samples of a capture.
const MAX_SAMPLES: usize = 20_000;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader(bytes);
    let hints = hints(&mut reader);
    let mut capture = capture(&mut reader);
    while !reader.is_empty() {
        damage(&mut capture, &mut reader);
    }
    match Survey::from_capture(&capture, &hints) {
        Ok(survey) => check(&survey, &capture),
        Err(why) => assert!(why.to_string().starts_with("fuzzed"), "{why}"),
    }
});

fn hints(reader: &mut Reader<'_>) -> Hints {
    let mut hint = |usual: [f64; 3]| match reader.u8() % 8 {
        at @ 0..3 => Some(usual[usize::from(at)]),
        3 => Some(reader.any_f64()),
        _ => None,
    };
    Hints {
        f_sw_hz: hint([45e3, 60e3, 1e9]),
        mains_hz: hint([50.0, 60.0, 1e-3]),
        zero_crossing_s: hint([0.0, 5e-3, -1e3]),
        ..Hints::default()
    }
}

/// A hob's voltage and current: a carrier and its third harmonic under the mains' envelope, and noise.
fn capture(reader: &mut Reader<'_>) -> Capture {
    let samples = usize::from(reader.u16()) % (MAX_SAMPLES + 1);
    let rate_hz = [1e6, 915e3, 250e3, 5e6, 200e3, 400e3][usize::from(reader.u8() % 6)];
    let rate_hz = rate_hz * reader.between(0.5, 1.5);
    let f_sw_hz = reader.between(5e3, 150e3);
    let mains_hz = reader.between(30.0, 80.0);
    let t0_s = reader.between(-0.1, 0.1);
    let floor = f64::from(reader.u8() % 4) / 3.0;
    let noise = f64::from(reader.u8()).powi(2) * 1e-4;
    let [level_v, level_i] = [300.0, 40.0];
    let lag = reader.between(-0.2, 1.8);
    let mut state = u64::from(reader.u8()) + 1;
    let mut random = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f64 / f64::from(1 << 23) - 1.0
    };
    let (mut v_v, mut i_a) = (Vec::new(), Vec::new());
    for k in 0..samples {
        let t_s = t0_s + k as f64 / rate_hz;
        let bus = (0.5 * TAU * 2.0 * mains_hz * t_s).sin().abs().max(floor);
        let turn = TAU * f_sw_hz * t_s;
        let v = turn.cos() + 0.2 * (3.0 * turn).cos() + noise * random();
        let i = (turn - lag).cos() + noise * random();
        v_v.push((level_v * bus * v) as f32);
        i_a.push((level_i * bus * i) as f32);
    }
    Capture {
        name: "fuzzed".to_owned(),
        time: TimeBase::Even {
            t0_s,
            dt_s: 1.0 / rate_hz,
        },
        v_v,
        i_a,
        ..Capture::default()
    }
}

/// One thing that happens to captures, or never should.
fn damage(capture: &mut Capture, reader: &mut Reader<'_>) {
    let what = reader.u8();
    let n = capture.len();
    let from = usize::from(reader.u16()) % (n + 1);
    let to = (from + usize::from(reader.u16())).min(n);
    let channel = if what & 0x80 == 0 {
        &mut capture.v_v
    } else {
        &mut capture.i_a
    };
    // One that was cut ends earlier.
    let part = from.min(channel.len())..to.min(channel.len());
    match what % 24 {
        0 => channel[part].fill(f32::NAN),
        1 => channel[part].fill(0.0),
        2 => channel[part].fill(f32::from_bits(reader.u32())),
        3 => {
            let factor = f32::from_bits(reader.u32());
            channel[part].iter_mut().for_each(|x| *x *= factor);
        }
        4 => {
            let offset = f32::from_bits(reader.u32());
            channel[part].iter_mut().for_each(|x| *x += offset);
        }
        5 => {
            let limit = reader.between(0.0, 350.0) as f32;
            channel.iter_mut().for_each(|x| *x = x.clamp(-limit, limit));
        }
        6 => channel.truncate(from),
        7 => std::mem::swap(&mut capture.v_v, &mut capture.i_a),
        8 => {
            capture.v_v.truncate(from);
            capture.i_a.truncate(from);
            if let TimeBase::Stamps(t_s) = &mut capture.time {
                t_s.truncate(from);
            }
        }
        9 => stamps(capture)[from..to]
            .iter_mut()
            .for_each(|t| *t += 1e-3),
        10 => {
            let by = reader.any_f64();
            stamps(capture)[from..to].iter_mut().for_each(|t| *t += by);
        }
        11 => {
            let by = reader.between(0.9, 1.1);
            stamps(capture)[from..].iter_mut().for_each(|t| *t *= by);
        }
        12 => {
            let digits = 10f64.powi(i32::from(reader.u8() % 12));
            let rounded = |t: &mut f64| *t = (*t * digits).round() / digits;
            stamps(capture).iter_mut().for_each(rounded);
        }
        13 => {
            let dt_s = reader.any_f64();
            capture.time = TimeBase::Even { t0_s: 0.0, dt_s };
        }
        14 => {
            let (t0_s, dt_s) = (reader.any_f64(), 1e-6);
            capture.time = TimeBase::Even { t0_s, dt_s };
        }
        15 | 16 => {
            let t_s = capture.time.at(from).unwrap_or(0.0);
            let f_sw_hz = match what % 24 {
                15 => reader.between(5e3, 150e3),
                _ => reader.any_f64(),
            };
            capture.f_sw.push(FrequencyStep { t_s, f_sw_hz });
        }
        17 => capture.mains_hz = Some(reader.any_f64()),
        18 => capture.zero_crossing_s = Some(reader.any_f64()),
        19 => capture.v_full_scale_v = Some(reader.any_f64()),
        20 => capture.i_full_scale_a = Some(reader.between(0.0, 50.0)),
        // Another frequency from here on: the samples of every second or third.
        21 => {
            let every = usize::from(reader.u8() % 4) + 1;
            for x in [&mut capture.v_v, &mut capture.i_a] {
                for k in from..x.len() {
                    x[k] = x[(k * every) % x.len()];
                }
            }
        }
        // Exactly the other one: a resistor, or a short between the probes.
        22 => capture.i_a.clone_from(&capture.v_v),
        _ => {
            let size = reader.between(1e-3, 100.0) as f32;
            channel
                .iter_mut()
                .for_each(|x| *x = (*x / size).round() * size);
        }
    }
}

/// The capture's times as stamps.
fn stamps(capture: &mut Capture) -> &mut [f64] {
    let n = capture.len();
    if let TimeBase::Even { .. } = capture.time {
        let at = |k| capture.time.at(k).unwrap_or(0.0);
        capture.time = TimeBase::Stamps((0..n).map(at).collect());
    }
    match &mut capture.time {
        TimeBase::Stamps(t_s) => {
            t_s.resize(n, 0.0);
            t_s
        }
        TimeBase::Even { .. } => &mut [],
    }
}

fn check(survey: &Survey, capture: &Capture) {
    finite(&Survey {
        findings: Vec::new(),
        ..survey.clone()
    });
    for finding in &survey.findings {
        assert!(!finding.to_string().is_empty());
        // This one shows the time that is none.
        if !matches!(finding, Finding::TimeNotAscending { .. }) {
            finite(finding);
        }
    }
    let mut end = 0;
    for span in &survey.spans {
        assert!(span.first >= end, "{span:?}");
        end = span.first + span.samples;
        assert!(end <= capture.len() && span.samples > 0, "{span:?}");
        assert!(span.dt_s > 0.0 && span.f_sw_hz > 0.0, "{span:?}");
        let segment = survey.segment(capture, span);
        assert_eq!(
            (segment.v_v.len(), segment.i_a.len()),
            (span.samples, span.samples)
        );
        let samples = || segment.v_v.iter().chain(&segment.i_a);
        assert!(samples().all(|x| x.is_finite()));
        if segment.check().is_ok() {
            let mut covered = 0;
            for (from, to) in segment.half_cycles() {
                assert!(from == covered && to > from, "{from} {to}");
                covered = to;
            }
            assert_eq!(covered, span.samples);
        }
    }
    for (from_s, to_s) in &survey.half_cycles_s {
        assert!(from_s < to_s, "{from_s} {to_s}");
    }
}

/// No number in a value's debug text is infinite or none; names of fields are other words.
fn finite(value: &impl std::fmt::Debug) {
    let text = format!("{value:?}");
    let mut words = text.split(|c: char| !c.is_alphanumeric() && c != '_');
    assert!(!words.any(|w| w == "inf" || w == "NaN"), "{text}");
}
