//! Captures that are read in parts: together they are the whole, cut where the mains crosses zero, whatever the file has been through.

use std::path::{Path, PathBuf};

use ihd_capture::mcap::FileLosses;
use ihd_capture::open::salvage_with;
use ihd_capture::{CaptureError, OpenOptions, PartReader};
use ihd_signal::{Capture, TimeBase};
use ihd_sim::recording::run::record;
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

/// Pairs of a part; at 10 MS/s it lasts 30 ms.
const PAIRS: usize = 300_000;

/// Nine half-cycles at 10 MS/s with a step of the frequency, truth included.
fn simulated() -> Capture {
    let mut settings = CaptureSpec {
        load: LoadKind::Behavioural,
        duration_s: 90e-3,
        events: vec![RecordingEvent {
            t_s: 41e-3,
            change: RecordingChange::Frequency(50e3),
        }],
        ..CaptureSpec::default()
    };
    settings.sensing.rate = Rate::Hz(10e6);
    record(&settings, |_| ()).unwrap().capture("of a test")
}

fn parts(path: &Path, options: &OpenOptions) -> Result<(Vec<Capture>, FileLosses), CaptureError> {
    let mut reader = PartReader::open_in(path, options, PAIRS, &mut |_| ())?;
    let mut parts = Vec::new();
    while !reader.is_at_end()? {
        parts.extend(reader.next_part()?);
    }
    assert!(reader.next_part()?.is_none(), "nothing after the end");
    Ok((parts, reader.losses()))
}

fn start_s(capture: &Capture) -> f64 {
    capture.time.at(0).unwrap()
}

/// Joins parts and compares them with the capture that was opened at once.
fn assert_whole(path: &Path, options: &OpenOptions) -> Vec<Capture> {
    let whole = salvage_with(path, options, &mut |_| ()).unwrap();
    let (parts, losses) = parts(path, options).unwrap();
    let whole_capture = whole.capture;
    assert_eq!(losses, whole.losses);
    let (mut v, mut i, mut at) = (Vec::new(), Vec::new(), 0);
    for part in &parts {
        let due_s = whole_capture.time.at(at).unwrap();
        assert!(
            (start_s(part) - due_s).abs() < 1e-12,
            "{} for {due_s}",
            start_s(part)
        );
        assert_eq!(part.mains_hz, whole_capture.mains_hz);
        assert_eq!(part.v_full_scale_v, whole_capture.v_full_scale_v);
        assert_eq!(part.metadata, whole_capture.metadata);
        at += part.len();
        v.extend_from_slice(&part.v_v);
        i.extend_from_slice(&part.i_a);
    }
    assert!(
        v == whole_capture.v_v && i == whole_capture.i_a,
        "samples differ"
    );
    parts
}

fn written(folder: &Path, capture: &Capture, name: &str) -> PathBuf {
    let path = folder.join(name);
    ihd_capture::write(capture, &path, &mut |_| ()).unwrap();
    path
}

#[test]
fn parts_are_the_whole_cut_at_zero_crossings_with_the_truth_of_their_time() {
    let folder = tempfile::tempdir().unwrap();
    let capture = simulated();
    let options = OpenOptions::default();
    for name in ["a.mcap", "a.npz"] {
        let path = written(folder.path(), &capture, name);
        let parts = assert_whole(&path, &options);
        // The crossing at 30 ms may lie behind the cut.
        assert!((3..=4).contains(&parts.len()), "{name}");
        for part in &parts[1..] {
            let off_s = (start_s(part) + 5e-3).rem_euclid(10e-3) - 5e-3;
            assert!(off_s.abs() < 50e-6, "{name}: {off_s}");
        }
        let truth: Vec<_> = parts.iter().flat_map(|p| p.truth.clone()).collect();
        assert_eq!(truth.len(), capture.truth.len(), "{name}");
        for (part, next) in parts.iter().zip(&parts[1..]) {
            let (from_s, to_s) = (start_s(part), start_s(next));
            assert!(
                part.truth.iter().all(|t| (from_s..to_s).contains(&t.t_s)),
                "{name}"
            );
        }
    }
}

#[test]
fn a_rate_that_the_user_states_counts_from_the_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let capture = simulated();
    let options = OpenOptions {
        rate_hz: Some(12e6),
        ..OpenOptions::default()
    };
    for name in ["a.mcap", "a.npz"] {
        assert_whole(&written(folder.path(), &capture, name), &options);
    }
}

#[test]
fn stamps_and_gaps_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = simulated();
    let n = capture.len();
    let t_s = (0..n).map(|k| k as f64 * 1e-7 + if k > n / 2 { 7e-3 } else { 0.0 });
    capture.time = TimeBase::Stamps(t_s.collect());
    let path = written(folder.path(), &capture, "a.mcap");
    assert!(assert_whole(&path, &OpenOptions::default()).len() >= 3);
}

#[test]
fn a_short_capture_is_one_part() {
    let folder = tempfile::tempdir().unwrap();
    let capture = simulated().part(0..PAIRS + PAIRS / 2);
    for name in ["a.mcap", "a.npz"] {
        let path = written(folder.path(), &capture, name);
        let (parts, _) = parts(&path, &OpenOptions::default()).unwrap();
        let whole = ihd_capture::open(&path, &OpenOptions::default()).unwrap();
        assert!(parts == [whole], "{name}");
    }
}

#[test]
fn a_damaged_or_cut_file_gives_what_can_be_read_and_the_same_losses() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &simulated(), "a.mcap");
    let sound = std::fs::read(&path).unwrap();
    let n = sound.len();
    for places in [vec![n / 3], vec![n / 2, n / 2 + n / 4], vec![60, n - 2000]] {
        let mut bytes = sound.clone();
        places.iter().for_each(|at| bytes[*at] ^= 0x5A);
        std::fs::write(&path, &bytes).unwrap();
        if salvage_with(&path, &OpenOptions::default(), &mut |_| ()).is_ok() {
            assert_whole(&path, &OpenOptions::default());
        } else {
            assert!(parts(&path, &OpenOptions::default()).is_err(), "{places:?}");
        }
    }
    std::fs::write(&path, &sound[..n - n / 3]).unwrap();
    assert_whole(&path, &OpenOptions::default());
}
