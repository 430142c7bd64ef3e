use std::f64::consts::TAU;

use self::fit::Law;
use super::*;
use crate::Severity;

/// A rectified envelope that a load bends and a capacitor may hold up.
fn envelope(hz: f64, t0_s: f64, from_s: f64, to_s: f64, floor: f64) -> PieceEnvelope {
    let n = ((to_s - from_s) / 50e-6) as usize;
    let t_s: Vec<f64> = (0..n).map(|k| from_s + 50e-6 * k as f64).collect();
    let level = |t: &f64| {
        let s = (TAU * hz * (t - t0_s)).sin().abs();
        (s * 200.0 / (1.0 + 0.3 * s)).max(floor)
    };
    PieceEnvelope {
        level: t_s.iter().map(level).collect(),
        t_s,
    }
}

fn found(e: &[PieceEnvelope]) -> (Mains, Vec<Finding>) {
    let mut findings = Vec::new();
    (
        find(e, None, None, e[0].t_s[0], 10e6, &mut findings),
        findings,
    )
}

#[test]
fn frequency_and_crossing_of_clean_and_held_envelopes() {
    for hz in [48.6, 50.0, 59.9, 61.4] {
        for (length_s, floor) in [(20e-3, 0.0), (100e-3, 0.0), (1.0, 0.0), (40e-3, 30.0)] {
            let (m, findings) = found(&[envelope(hz, 1.234e-3, 0.0, length_s, floor)]);
            assert!(findings.is_empty(), "{findings:?}");
            assert!((m.hz - hz).abs() < 0.3, "{hz} {length_s}: {m:?}");
            assert!(
                (m.zero_crossing_s - 1.234e-3).abs() < 0.1e-3,
                "{hz} {length_s}: {m:?}"
            );
        }
    }
}

/// A rate stated too high or too low turns 50 or 60 Hz into what no grid has.
#[test]
fn a_mains_of_no_grid_is_a_wrong_time_base() {
    let shown = |e: PieceEnvelope| {
        let (_, findings) = found(&[e]);
        let shown = findings.iter().find_map(|f| match f {
            Finding::TimeBase { shown_hz, .. } => Some((*shown_hz, f.severity())),
            _ => None,
        });
        (shown, findings)
    };
    for hz in [
        22.9, 25.0, 30.0, 40.0, 45.0, 47.0, 54.64, 62.5, 83.0, 100.0, 120.0, 125.0,
    ] {
        for (length_s, t0_s, floor) in [
            (8e-3, 1.234e-3, 0.0),
            (8e-3, 0.0, 0.0),
            (0.02, 1.234e-3, 0.0),
            (0.1, 1.234e-3, 0.0),
            (0.1, 1.234e-3, 30.0),
        ] {
            if 2.0 * hz * length_s < 1.6 {
                continue;
            }
            let (shown, findings) = shown(envelope(hz, t0_s, 0.0, length_s, floor));
            let (shown_hz, severity) = shown.unwrap_or((0.0, Severity::Info));
            assert!(
                (shown_hz / hz - 1.0).abs() < 0.02,
                "{hz} {length_s} {floor}: {findings:?}"
            );
            let is_possible = (45.0..65.0).contains(&hz);
            assert_eq!(
                severity == Severity::Warning,
                is_possible,
                "{hz}: {findings:?}"
            );
        }
    }
    for (hz, length_s) in [
        (50.0, 0.1),
        (49.0, 0.02),
        (61.2, 0.02),
        (63.0, 0.0079),
        (50.0, 0.004),
    ] {
        let (shown, findings) = shown(envelope(hz, 1.234e-3, 0.0, length_s, 0.0));
        assert_eq!(shown, None, "{hz}: {findings:?}");
    }
}

#[test]
fn one_half_cycle_separates_50_from_60() {
    for (hz, half_s) in [(50.0, 10e-3), (60.0, 8.333e-3)] {
        let (m, _) = found(&[envelope(hz, 0.0, 0.0, half_s, 0.0)]);
        assert_eq!(m.hz, hz);
        let off_s = m.zero_crossing_s.min(0.5 / hz - m.zero_crossing_s);
        assert!(off_s.abs() < 0.1e-3, "{m:?}");
    }
}

#[test]
fn pieces_of_different_level_share_their_mains() {
    let mut second = envelope(50.0, 2e-3, 15e-3, 40e-3, 0.0);
    second.level.iter_mut().for_each(|x| *x *= 0.3);
    let (m, _) = found(&[envelope(50.0, 2e-3, 0.0, 15e-3, 0.0), second]);
    assert!((m.hz - 50.0).abs() < 0.3 && (m.zero_crossing_s - 2e-3).abs() < 0.1e-3);
}

/// One half-cycle of several, for seconds, which `ihd record` and a scope's segments give. Every grid keeps within a hertz of its nominal
/// frequency.
#[test]
fn half_cycles_with_pauses_have_the_frequency_of_a_grid() {
    for hz in [50.0, 49.95, 60.02] {
        for (lasts_s, every_s) in [(12e-3, 50e-3), (10e-3, 190e-3), (10e-3, 0.2), (25e-3, 0.3)] {
            for (t0_s, floor) in [(1.234e-3, 0.0), (6.0e-3, 0.0), (1.234e-3, 30.0)] {
                let pieces: Vec<_> = (0..20)
                    .map(|k| f64::from(k) * every_s)
                    .map(|from_s| envelope(hz, t0_s, from_s, from_s + lasts_s, floor))
                    .collect();
                let (m, findings) = found(&pieces);
                let case = format!("{hz} Hz, {lasts_s} s every {every_s} s: {m:?}");
                assert!(findings.is_empty(), "{case} {findings:?}");
                assert!((m.hz - hz).abs() < 0.02, "{case}");
                let half_s = 0.5 / hz;
                let off_s =
                    (m.zero_crossing_s - t0_s + 0.5 * half_s).rem_euclid(half_s) - 0.5 * half_s;
                assert!(off_s.abs() < 0.1e-3, "{case} {off_s}");
            }
        }
    }
}

#[test]
fn a_constant_bus_and_a_short_capture_are_noted() {
    let mut flat = envelope(50.0, 0.0, 0.0, 30e-3, 0.0);
    flat.level.fill(10.0);
    for e in [flat, envelope(50.0, 0.0, 4e-3, 6e-3, 0.0)] {
        let (m, findings) = found(&[e]);
        assert_eq!(m.hz_source, MainsSource::Assumed);
        assert!(matches!(findings[..], [Finding::MainsUnknown { .. }]));
    }
}

/// Found by fuzzing, and on a recording of a device: start + (end − start) may lie before the end.
#[test]
fn the_search_ends_wherever_the_envelope_does() {
    for k in 0..100 {
        let to_s = -34.5e-3 + 1e-3 * f64::from(k);
        let e = [envelope(50.0, 0.0, -0.1, to_s, 0.0)];
        let m = find(&e, Some(50.0), None, -0.1, 10e6, &mut Vec::new());
        assert!(m.zero_crossing_s.is_finite());
    }
}

/// Found by fuzzing: thousands of halvings down from a half-cycle of 1e150 s.
#[test]
fn no_crossing_is_looked_for_at_a_frequency_that_no_mains_has() {
    let e = [envelope(50.0, 0.0, 0.0, 40e-3, 0.0)];
    for hz in [1e-150, 1e-3, 1e19] {
        let m = find(&e, Some(hz), None, 0.0, 10e6, &mut Vec::new());
        assert_eq!((m.hz, m.zero_crossing_source), (hz, MainsSource::Assumed));
    }
}

/// Windows that a device sends every 20 half-cycles: 48.74 Hz fit them as well, and were reported.
#[test]
fn half_cycles_with_pauses_do_not_contradict_the_frequency_told() {
    let windows = |hz: f64| -> Vec<PieceEnvelope> {
        let half_s = 0.5 / hz;
        (0..24)
            .map(|k| f64::from(20 * k) * half_s)
            .map(|from_s| envelope(hz, 0.0, from_s, from_s + half_s, 0.0))
            .collect()
    };
    for hz in [49.99, 50.0, 60.0] {
        let mut findings = Vec::new();
        let m = find(&windows(hz), Some(hz), Some(0.0), 0.0, 10e6, &mut findings);
        assert_eq!((m.hz, findings), (hz, Vec::new()));
    }
    // A real difference is still reported.
    let mut findings = Vec::new();
    let e = [envelope(52.0, 0.0, 0.0, 60e-3, 0.0)];
    find(&e, Some(50.0), None, 0.0, 10e6, &mut findings);
    assert!(
        matches!(findings[..], [Finding::MainsDiffers { measured_hz, .. }, ..] if (measured_hz - 52.0).abs() < 0.3),
        "{findings:?}"
    );
}

#[test]
fn times_that_are_no_numbers_end_the_search() {
    let mut e = envelope(50.0, 0.0, 0.0, 40e-3, 0.0);
    if let Some(last) = e.t_s.last_mut() {
        *last = f64::NAN;
    }
    assert!(fit(&[e], Search::At(50.0, Law::Held)).is_none_or(|fit| fit.t0_s.is_finite()));
}

#[test]
fn what_is_specified_is_used_and_checked() {
    let e = [envelope(50.0, 0.0, 0.0, 40e-3, 0.0)];
    let mut findings = Vec::new();
    let m = find(&e, Some(60.0), Some(1e-3), 0.0, 10e6, &mut findings);
    assert_eq!((m.hz, m.zero_crossing_s), (60.0, 1e-3));
    assert!(matches!(findings[..], [Finding::MainsDiffers { .. }]));
}

/// A time of another clock, in another unit, or of another column.
#[test]
fn a_crossing_that_the_envelope_shows_elsewhere_is_reported() {
    for (specified_s, is_reported) in [
        (1e-3, false),
        (1.1e-3, false),
        (-9e-3, false),
        (1.3e-3, true),
        (0.7e-3, true),
        (1.0, true),
        (6e-3, true),
    ] {
        for (length_s, floor) in [(10e-3, 0.0), (40e-3, 0.0), (0.1, 30.0)] {
            let e = [envelope(50.0, 1e-3, 0.0, length_s, floor)];
            let mut findings = Vec::new();
            let m = find(&e, Some(50.0), Some(specified_s), 0.0, 10e6, &mut findings);
            assert_eq!(m.zero_crossing_s, specified_s);
            let off_s = findings.iter().find_map(|f| match f {
                Finding::CrossingDiffers { measured_s, .. } => Some(measured_s - 1e-3),
                _ => None,
            });
            assert_eq!(off_s.is_some(), is_reported, "{specified_s} {length_s}");
            let turns = off_s.unwrap_or(0.0) / 10e-3;
            assert!(
                (turns - turns.round()).abs() < 0.01,
                "{specified_s} {turns}"
            );
        }
    }
}

/// One half-cycle separates 50 Hz from 60 Hz, also where the wrong one is told.
#[test]
fn one_half_cycle_contradicts_the_frequency_told() {
    for (hz, told_hz, half_s) in [
        (50.0, 50.0, 10e-3),
        (60.0, 60.0, 10e-3),
        (60.0, 50.0, 10e-3),
        (50.0, 60.0, 10e-3),
    ] {
        let mut findings = Vec::new();
        let e = [envelope(hz, 0.0, 0.0, half_s, 0.0)];
        find(&e, Some(told_hz), None, 0.0, 10e6, &mut findings);
        let seen = findings.iter().find_map(|f| match f {
            Finding::MainsDiffers { measured_hz, .. } => Some(*measured_hz),
            _ => None,
        });
        assert_eq!(seen, (hz != told_hz).then_some(hz), "{findings:?}");
    }
}
