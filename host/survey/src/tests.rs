//! The survey against captures of the simulator, whose settings are the truth.

mod bad_input;

use ihd_sim::inverter::harmonic_analyser::HarmonicAnalyser;
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

use super::*;

fn settings(f_sw_hz: f64, duration_s: f64) -> CaptureSpec {
    CaptureSpec {
        load: LoadKind::Behavioural,
        f_sw_hz,
        duration_s,
        ..CaptureSpec::default()
    }
}

/// A capture that states nothing but its samples.
fn capture(settings: &CaptureSpec) -> Capture {
    let recording = record(settings, |_| ()).unwrap();
    Capture {
        f_sw: Vec::new(),
        mains_hz: None,
        zero_crossing_s: None,
        truth: Vec::new(),
        ..recording.capture("simulated")
    }
}

fn survey(capture: &Capture) -> Survey {
    Survey::from_capture(capture, &Hints::default()).unwrap()
}

/// Distance of a time from the nearest zero crossing of a mains whose crossing is at `-start_s`.
fn off_crossing_s(t_s: f64, settings: &CaptureSpec) -> f64 {
    let half_s = 0.5 / settings.mains_hz;
    let phase = (t_s + settings.start_s).rem_euclid(half_s);
    phase.min(half_s - phase)
}

#[test]
fn a_clean_capture_has_no_findings_and_its_own_numbers() {
    let s = settings(45e3, 20e-3);
    let got = survey(&capture(&s));
    assert_eq!(got.findings, []);
    assert_eq!(got.spans.len(), 1);
    assert!((got.spans[0].f_sw_hz - 45e3).abs() < 0.5, "{:?}", got.spans);
    assert_eq!(got.spans[0].samples, got.samples);
    assert!((got.mains.hz - 50.0).abs() < 0.2, "{:?}", got.mains);
    assert!(off_crossing_s(got.mains.zero_crossing_s, &s) < 0.1e-3);
    assert_eq!(got.half_cycles_s.len(), 2, "{:?}", got.half_cycles_s);
    // 16 bits of 80 A: step 2.4 mA, noise step/√12 = 0.7 mA; the current has 20 A rms.
    let snr_db = got.current.snr_db.unwrap();
    assert!((80.0..95.0).contains(&snr_db), "{snr_db}");
    let (voltage, current) = (got.voltage, got.current);
    assert!((100.0..250.0).contains(&voltage.rms) && (10.0..40.0).contains(&current.rms));
}

#[test]
fn rates_frequencies_mains_and_noise() {
    let rates = [
        Rate::Locked,
        Rate::Hz(1e6),
        Rate::Hz(2.5e6),
        Rate::Hz(12.5e6),
    ];
    let mut seed = 10;
    for (rate, f_sw_hz) in rates.into_iter().zip([45e3, 50.3e3, 61.7e3, 70e3]) {
        for (mains_hz, snr_db) in [(50.0, 30.0), (60.0, 30.0), (49.8, 50.0)] {
            seed += 1;
            let mut s = settings(f_sw_hz, 25e-3);
            (s.mains_hz, s.seed, s.start_s) = (mains_hz, seed, 4e-3);
            s.sensing.rate = rate;
            s.sensing.allow_aliasing = true;
            s.sensing.snr_db = Some(snr_db);
            let got = survey(&capture(&s));
            let case = format!("{rate:?} {f_sw_hz} {mains_hz} {snr_db}");
            assert_eq!(got.spans.len(), 1, "{case} {:?}", got.spans);
            let f = got.spans[0].f_sw_hz;
            assert!((f - f_sw_hz).abs() < 1.0, "{case}: {f}");
            assert!(
                (got.mains.hz - mains_hz).abs() < 0.5,
                "{case}: {:?}",
                got.mains
            );
            let off_s = off_crossing_s(got.mains.zero_crossing_s, &s);
            assert!(off_s < 0.15e-3, "{case}: {off_s}");
            for channel in [got.voltage, got.current] {
                // At 50 dB the harmonics beyond half of 1 MS/s weigh too.
                let tolerance_db = if snr_db > 40.0 { 2.5 } else { 1.0 };
                let error_db = channel.snr_db.unwrap() - snr_db;
                assert!(error_db.abs() < tolerance_db, "{case}: {channel:?}");
            }
            assert!(
                got.worst() != Some(Severity::Error),
                "{case}: {:?}",
                got.findings
            );
        }
    }
}

#[test]
fn a_part_of_a_half_cycle_gives_its_frequency_and_says_what_it_lacks() {
    for start_s in [1e-3, 3e-3, 6e-3] {
        let mut s = settings(45e3, 2.5e-3);
        s.start_s = start_s;
        s.sensing.rate = Rate::Hz(12.5e6);
        let got = survey(&capture(&s));
        // 20 Hz turn the phase by a twentieth of a circle, and are 0.04 % of L.
        assert!(
            (got.spans[0].f_sw_hz - 45e3).abs() < 20.0,
            "{:?}",
            got.spans
        );
        let unknown = |f: &Finding| matches!(f, Finding::MainsUnknown { .. });
        assert!(got.findings.iter().any(unknown), "{:?}", got.findings);
        let hints = Hints {
            mains_hz: Some(50.0),
            zero_crossing_s: Some(-start_s),
            ..Hints::default()
        };
        let hinted = Survey::from_capture(&capture(&s), &hints).unwrap();
        assert!(
            !hinted.findings.iter().any(unknown),
            "{:?}",
            hinted.findings
        );
    }
}

#[test]
fn frequency_steps_and_pauses_cut_the_capture_where_they_are() {
    for rate in [Rate::Hz(2.5e6), Rate::Locked] {
        let mut s = settings(45e3, 40e-3);
        s.sensing.rate = rate;
        s.sensing.allow_aliasing = true;
        s.sensing.snr_db = Some(30.0);
        let event = |t_s, change| RecordingEvent { t_s, change };
        s.events = vec![
            event(7e-3, RecordingChange::Frequency(46e3)),
            event(16e-3, RecordingChange::Frequency(60e3)),
            event(24e-3, RecordingChange::Off),
            event(30e-3, RecordingChange::On),
        ];
        let got = survey(&capture(&s));
        let spans: Vec<_> = got
            .spans
            .iter()
            .map(|p| (p.t0_s, p.end_s(), p.f_sw_hz))
            .collect();
        let truth = [
            (0.0, 7e-3, 45e3),
            (7e-3, 16e-3, 46e3),
            (16e-3, 24e-3, 60e3),
            (30e-3, 40e-3, 60e3),
        ];
        assert_eq!(
            spans.len(),
            truth.len(),
            "{rate:?} {spans:?} {:?}",
            got.findings
        );
        for (got, truth) in spans.iter().zip(truth) {
            assert!((got.2 - truth.2).abs() < 3.0, "{got:?} {truth:?}");
            // Nothing of another frequency, and little lost. The change waits for the period's end.
            let period_s = 1.0 / 45e3;
            assert!(
                got.0 > truth.0 && got.0 < truth.0 + 0.8e-3 || truth.0 == 0.0,
                "{got:?}"
            );
            assert!(got.1 < truth.1 + 1.2 * period_s, "{got:?} {truth:?}");
            assert!(got.1 > truth.1 - 0.8e-3, "{got:?} {truth:?}");
        }
        let steps = got
            .findings
            .iter()
            .filter(|f| matches!(f, Finding::FrequencyStep { .. }));
        assert_eq!(steps.count(), 2);
        // Switched on at a zero crossing: the half-cycle counts, as does the one from 10 to 20 ms not.
        assert_eq!(got.half_cycles_s.len(), 1, "{:?}", got.half_cycles_s);
        let off = |f: &Finding| matches!(f, Finding::CarrierAbsent { .. });
        assert_eq!(got.findings.iter().filter(|f| off(f)).count(), 1);
    }
}

#[test]
fn exchanged_and_reversed_probes_are_found() {
    let mut s = settings(50e3, 10e-3);
    s.sensing.rate = Rate::Locked;
    s.sensing.snr_db = Some(30.0);
    let clean = capture(&s);
    let r_ohm = survey(&clean).spans[0].load.unwrap().r_ohm;
    for (swapped, inverted) in [(true, false), (false, true), (true, true)] {
        let mut c = clean.clone();
        if inverted {
            c.i_a.iter_mut().for_each(|i| *i = -*i);
        }
        if swapped {
            std::mem::swap(&mut c.v_v, &mut c.i_a);
        }
        c.v_full_scale_v = None;
        c.i_full_scale_a = None;
        let got = survey(&c);
        assert_eq!(got.wiring, Wiring { swapped, inverted });
        assert_eq!(got.worst(), Some(Severity::Error));
        // The numbers are those of the repaired wiring.
        let repaired = got.spans[0].load.unwrap().r_ohm;
        assert!((repaired / r_ohm - 1.0).abs() < 1e-6, "{repaired} {r_ohm}");
        assert!(got.half_cycles_s.len() == 1, "{:?}", got.mains);
    }
}

/// Mean relative error of R in percent of a capture at 50 MS/s and 50 kHz: a thousand samples a
/// period, so that the simulator's own meter can measure the samples.
fn r_error_pct(skew_s: f64) -> f64 {
    let mut s = settings(50e3, 10e-3);
    s.sensing.skew_s = skew_s;
    let r = record(&s, |_| ()).unwrap();
    let mut sum = (0.0, 0);
    for (k, truth) in r.truth.iter().enumerate() {
        let boundary = k * 1000;
        if k == 0 || truth.i_a < 0.05 * 60.0 || boundary + 1000 >= r.v_clean_v.len() {
            continue;
        }
        let sums = |from: usize| {
            let mut analyser = HarmonicAnalyser::new(1000);
            for n in 0..=1000 {
                analyser.push(n, r.v_clean_v[from + n], r.i_clean_a[from + n]);
            }
            analyser.sums().clone()
        };
        let got = sums(boundary - 1000).across(&sums(boundary), truth.t_s, 50e3);
        sum = (
            sum.0 + (got.r_ohm[0] / truth.r_ohm[0] - 1.0).abs(),
            sum.1 + 1,
        );
    }
    assert!(sum.1 > 300, "{sum:?}");
    100.0 * sum.0 / f64::from(sum.1)
}

#[test]
fn the_cost_of_a_skew_is_what_a_skewed_capture_shows() {
    let got = survey(&capture(&settings(50e3, 10e-3)));
    assert!(r_error_pct(0.0) < 0.05);
    for cost in got.skew {
        let shown = r_error_pct(cost.skew_s);
        assert!(
            (cost.r_pct / shown - 1.0).abs() < 0.1,
            "{cost:?} but {shown} %"
        );
        // docs/accuracy.md, "Skew and calibration": 20 ns cost 1 to 1.8 %.
        if cost.skew_s == 20e-9 {
            assert!((1.0..1.8).contains(&cost.r_pct), "{cost:?}");
        }
    }
}

#[test]
fn a_whole_number_of_samples_a_period_aliases_as_predicted() {
    // Every fifth sample of 100 a period, from each of five starts: five positions of the samples
    // relative to the edges.
    let mut s = settings(45e3, 10e-3);
    s.sensing.rate = Rate::Hz(100.0 * 45e3);
    s.sensing.allow_aliasing = true;
    let fine = capture(&s);
    let reference = survey(&fine).spans[0].load.unwrap().r_ohm;
    let (mut predicted_pct, mut square) = (0.0, 0.0);
    for start in 0..5 {
        let every = |x: &[f32]| x.iter().skip(start).step_by(5).copied().collect();
        let coarse = Capture {
            time: TimeBase::Even {
                t0_s: start as f64 / 4.5e6,
                dt_s: 5.0 / 4.5e6,
            },
            v_v: every(&fine.v_v),
            i_a: every(&fine.i_a),
            ..fine.clone()
        };
        let got = survey(&coarse);
        let alias = |f: &&Finding| matches!(f, Finding::Aliasing { order: 19, .. });
        let finding = got
            .findings
            .iter()
            .find(alias)
            .expect("aliasing is reported");
        assert_eq!(finding.severity(), Severity::Warning);
        predicted_pct = got.aliasing.unwrap().r_pct;
        let shown = 100.0 * (got.spans[0].load.unwrap().r_ohm / reference - 1.0);
        square += shown * shown / 5.0;
    }
    let shown_pct = square.sqrt();
    assert!(
        (0.5..2.0).contains(&(predicted_pct / shown_pct)),
        "predicted {predicted_pct} %, shown {shown_pct} %"
    );
}

#[test]
fn clipping_and_offsets_are_reported_with_channel_and_size() {
    let mut s = settings(45e3, 20e-3);
    s.sensing.rate = Rate::Hz(12.5e6);
    s.sensing.i_full_scale_a = 40.0;
    s.sensing.v_offset_v = 6.0;
    let mut c = capture(&s);
    for known in [true, false] {
        if !known {
            c.i_full_scale_a = None;
        }
        let got = survey(&c);
        let truth = c.i_a.iter().filter(|i| i.abs() > 39.9).count();
        let clipping = got.findings.iter().find_map(|f| match f {
            Finding::Clipping {
                channel: Channel::Current,
                samples,
                level,
                ..
            } => Some((*samples, *level)),
            _ => None,
        });
        let (samples, level) = clipping.expect("clipping is reported");
        assert!(samples.abs_diff(truth) < truth / 10, "{samples} {truth}");
        assert!((level - 40.0).abs() < 0.1);
        let offset = got.findings.iter().find_map(|f| match f {
            Finding::Offset {
                channel: Channel::Voltage,
                mean,
                ..
            } => Some(*mean),
            _ => None,
        });
        assert!((offset.unwrap() - 6.0).abs() < 0.5, "{offset:?}");
    }
}

#[test]
fn a_dead_channel_and_a_gap_are_reported() {
    let mut s = settings(45e3, 20e-3);
    s.sensing.rate = Rate::Locked;
    let mut c = capture(&s);
    if let TimeBase::Stamps(t_s) = &mut c.time {
        t_s[8000..].iter_mut().for_each(|t| *t += 1.5e-3);
    }
    let got = survey(&c);
    assert_eq!(got.spans.len(), 2);
    assert!(
        matches!(got.findings[0], Finding::Gap { gaps: 1, .. }),
        "{:?}",
        got.findings
    );
    c.i_a.fill(0.25);
    let got = survey(&c);
    let dead = Finding::Dead {
        channel: Channel::Current,
    };
    assert!(got.findings.contains(&dead), "{:?}", got.findings);
}

#[test]
fn json_keeps_the_keys_that_users_have() {
    let finding = Finding::MainsDiffers {
        specified_hz: 60.0,
        measured_hz: 50.0,
    };
    let json = serde_json::to_value(finding).unwrap();
    assert_eq!(json["told_hz"], 60.0);
    let source = serde_json::to_value(mains::MainsSource::Specified).unwrap();
    assert_eq!(source, "told");
}

#[test]
fn what_the_user_did_is_to_be_undone_not_done_again() {
    let mut c = capture(&settings(50e3, 10e-3));
    (c.v_full_scale_v, c.i_full_scale_a) = (None, None);
    let told = |c: &Capture, hints: Hints| {
        let survey = Survey::from_capture(c, &hints).unwrap();
        let wiring = |f: &&Finding| matches!(f, Finding::Swapped { .. } | Finding::Inverted { .. });
        let found = survey.findings.iter().find(wiring);
        found.map(ToString::to_string).unwrap_or_default()
    };
    std::mem::swap(&mut c.v_v, &mut c.i_a);
    assert!(told(&c, Hints::default()).ends_with("use --input swap"));
    let swapped = Hints {
        swapped: true,
        ..Hints::default()
    };
    assert!(told(&c, swapped).ends_with("leave out --input swap"));
    std::mem::swap(&mut c.v_v, &mut c.i_a);
    c.i_a.iter_mut().for_each(|i| *i = -*i);
    assert!(told(&c, Hints::default()).ends_with("use --input invert=i"));
    let inverted = Hints {
        inverted: true,
        ..Hints::default()
    };
    assert!(told(&c, inverted).ends_with("leave out --input invert"));
}

#[test]
fn a_probe_factor_that_gives_kilovolts_is_told() {
    let mut c = capture(&settings(50e3, 10e-3));
    // A probe of 1:10 taken for one of 1:100.
    c.v_v.iter_mut().for_each(|v| *v *= 10.0);
    c.v_full_scale_v = None;
    let survey = survey(&c);
    let told = survey
        .findings
        .iter()
        .find(|f| matches!(f, Finding::Implausible { .. }));
    let told = told.unwrap_or_else(|| panic!("{:?}", survey.findings));
    assert_eq!(told.severity(), Severity::Warning);
    assert!(told.to_string().contains("--input probe"), "{told}");
}

#[test]
fn a_capture_without_samples_says_so() {
    let mut c = capture(&settings(50e3, 1e-3));
    (c.v_v, c.i_a, c.time) = (
        Vec::new(),
        Vec::new(),
        TimeBase::Even {
            t0_s: 0.0,
            dt_s: 0.0,
        },
    );
    let refused = Survey::from_capture(&c, &Hints::default()).unwrap_err();
    assert!(matches!(refused, SurveyError::Empty { .. }));
    assert!(
        refused.to_string().ends_with("holds no samples"),
        "{refused}"
    );
}

/// The capture of a carrier that moves by so much, so often, both in hertz.
fn swept(deviation_hz: f64, rate_hz: f64) -> Capture {
    let mut s = settings(50e3, 20e-3);
    s.sweep = Some(ihd_sim::recording::settings::CarrierSweep {
        deviation_hz,
        rate_hz,
    });
    s.sensing.snr_db = Some(30.0);
    capture(&s)
}

#[test]
fn a_sweep_is_one_span_with_a_finding() {
    for (deviation, rate) in [(5e3, 100.0), (1e3, 1e3), (1e3, 47.0)] {
        let got = survey(&swept(deviation, rate));
        assert_eq!(got.spans.len(), 1, "{deviation} {rate}: {:?}", got.findings);
        assert!(got.spans[0].samples + 2 >= got.samples);
        let seen = got.findings.iter().find_map(|f| match f {
            Finding::FrequencySweep {
                mean_hz,
                deviation_hz,
                rate_hz,
            } => Some((*mean_hz, *deviation_hz, *rate_hz)),
            _ => None,
        });
        let (mean_hz, deviation_hz, rate_hz) = seen.expect("the sweep");
        assert!((mean_hz - 50e3).abs() < 0.5 * deviation, "{mean_hz}");
        assert!(
            (deviation_hz / deviation - 1.0).abs() < 0.1,
            "{deviation_hz}"
        );
        assert!((rate_hz / rate - 1.0).abs() < 0.2, "{rate_hz}");
    }
}

#[test]
fn the_firmwares_dither_is_steps_and_no_sweep() {
    // One percent up, back, one percent down, at the zero crossings.
    let mut s = settings(50e3, 40e-3);
    let at = |t_s: f64, f_hz: f64| RecordingEvent {
        t_s,
        change: RecordingChange::Frequency(f_hz),
    };
    s.events = vec![at(10e-3, 50.5e3), at(20e-3, 50e3), at(30e-3, 49.5e3)];
    let got = survey(&capture(&s));
    let sweeps = |f: &&Finding| matches!(f, Finding::FrequencySweep { .. });
    assert_eq!(got.findings.iter().filter(sweeps).count(), 0);
    let found: Vec<f64> = got.spans.iter().map(|s| s.f_sw_hz).collect();
    assert_eq!(found.len(), 4, "{found:?}");
    for (found, right) in found.iter().zip([50e3, 50.5e3, 50e3, 49.5e3]) {
        assert!((found - right).abs() < 5.0, "{found} {right}");
    }
}

/// Coil of 21 µH and 2.7 ohm with 1080 nF at a half-bridge of 325 V at the crest: harmonics by the impedances.
fn bridge_at(f_sw_hz: f64) -> Capture {
    use nalgebra::Complex;
    let harmonics: Vec<(f64, [Complex<f64>; 2])> = (0..12)
        .map(|k| f64::from(2 * k + 1))
        .map(|n| {
            let omega = std::f64::consts::TAU * n * f_sw_hz;
            let coil = Complex::new(2.7, omega * 21e-6);
            let i = 2.0 * 325.0
                / (std::f64::consts::PI * n)
                / (coil - Complex::new(0.0, 1.0 / (omega * 1080e-9)));
            (omega, [coil * i, i])
        })
        .collect();
    let dt_s = 0.25e-6;
    let sample = |k: u32, channel: usize| {
        let t_s = dt_s * f64::from(k);
        let mains = (std::f64::consts::TAU * 50.0 * t_s).sin().abs();
        let of = |(omega, h): &(f64, [Complex<f64>; 2])| {
            (h[channel] * Complex::from_polar(1.0, omega * t_s)).im
        };
        (mains * harmonics.iter().map(of).sum::<f64>()) as f32
    };
    Capture {
        name: "a bridge".to_owned(),
        time: TimeBase::Even { t0_s: 0.0, dt_s },
        v_v: (0..80_000).map(|k| sample(k, 0)).collect(),
        i_a: (0..80_000).map(|k| sample(k, 1)).collect(),
        ..Capture::default()
    }
}

/// At 12 kHz the resonance lifts the third harmonic above the fundamental.
#[test]
fn a_bridge_below_the_search_is_not_taken_for_one_at_its_harmonic() {
    let taken = |s: &Survey| {
        let order = |f: &Finding| match f {
            Finding::HarmonicTaken { order, .. } => Some(*order),
            _ => None,
        };
        s.findings.iter().find_map(order)
    };
    for f_sw_hz in [10e3, 12e3, 13e3] {
        let c = bridge_at(f_sw_hz);
        let got = survey(&c);
        assert_eq!(taken(&got), Some(3), "{f_sw_hz}: {:?}", got.findings);
        assert_eq!(got.worst(), Some(Severity::Error));
        let hints = Hints {
            f_sw_hz: Some(f_sw_hz),
            ..Hints::default()
        };
        let right = Survey::from_capture(&c, &hints).unwrap();
        assert!((right.spans[0].f_sw_hz - f_sw_hz).abs() < 5.0);
        assert_eq!(taken(&right), None, "{:?}", right.findings);
    }
    assert_eq!(taken(&survey(&bridge_at(45e3))), None);
}
