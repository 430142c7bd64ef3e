//! Memory that importing takes, and what damaged files do: peaks of a counting allocator. Tests in
//! this file take turns, as the counter is one for the process.

#[path = "../benches/scope_files/mod.rs"]
mod scope_files;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use ihd_capture::channels::{ChannelOptions, ChannelRef};
use ihd_capture::{CaptureError, OpenOptions, PartReader, open};
use ihd_signal::{Capture, TimeBase};
use peak_alloc::PeakAlloc;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Opens a file; gives the bytes taken beyond those before, at the peak.
fn peak(path: &Path, options: &OpenOptions) -> (Result<Capture, CaptureError>, usize) {
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let capture = open(path, options);
    (capture, MEMORY.peak_usage().saturating_sub(before))
}

#[test]
fn at_most_three_times_the_samples() {
    let _turn = turn();
    const SAMPLES: usize = 1_000_000;
    let folder = tempfile::tempdir().unwrap();
    let [v, i] = scope_files::wfm(folder.path(), SAMPLES);
    let pair = OpenOptions {
        second: Some(i),
        ..OpenOptions::default()
    };
    let single = OpenOptions::default();
    for (path, options) in [
        (v, &pair),
        (scope_files::csv(folder.path(), SAMPLES), &single),
        (scope_files::mat(folder.path(), SAMPLES), &single),
        (scope_files::npz(folder.path(), SAMPLES), &single),
    ] {
        let (capture, taken) = peak(&path, options);
        let capture = capture.unwrap();
        assert_eq!(capture.len(), SAMPLES);
        let samples = 2 * SAMPLES * size_of::<f32>();
        let name = path.file_name().unwrap().display();
        println!(
            "{name}: {:.2} times the samples",
            taken as f64 / samples as f64
        );
        assert!(taken <= 3 * samples, "{name}: {taken} bytes");
    }
}

/// A capture of ten parts takes the memory of two of them, and some: the part that is taken, and what is read beyond it.
#[test]
fn parts_take_the_memory_of_parts() {
    let _turn = turn();
    const PAIRS: usize = 100_000;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    let wave = |k: usize, period: f32| (k as f32 * period).sin();
    let capture = Capture {
        time: TimeBase::Even {
            t0_s: 0.0,
            dt_s: 1e-6,
        },
        v_v: (0..10 * PAIRS).map(|k| 300.0 * wave(k, 0.28)).collect(),
        i_a: (0..10 * PAIRS).map(|k| 40.0 * wave(k, 0.28)).collect(),
        ..Capture::default()
    };
    ihd_capture::write(&capture, &path, &mut |_| ()).unwrap();
    drop(capture);
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let options = OpenOptions::default();
    let mut reader = PartReader::open_in(&path, &options, PAIRS, &mut |_| ()).unwrap();
    let mut pairs = 0;
    while let Some(part) = reader.next_part().unwrap() {
        pairs += part.len();
    }
    let taken = MEMORY.peak_usage().saturating_sub(before);
    assert_eq!(pairs, 10 * PAIRS);
    let of_pairs = |n: usize| n * 2 * size_of::<f32>();
    // A chunk of 1 MiB, packed and unpacked, and the room of vectors that grow.
    let most = 2 * of_pairs(PAIRS) + 2 * of_pairs(3 * PAIRS / 2) + (4 << 20);
    assert!(taken < most, "{taken} bytes for {most}");
    assert!(taken < of_pairs(10 * PAIRS), "{taken} bytes");
}

fn fixtures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/formats");
    let mut all: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e != "py" && e != "md"))
        .collect();
    all.sort();
    assert!(all.len() > 30);
    all
}

/// Largest peak that a damaged file of a few kilobytes may cause: what a compressed array is believed
/// without looking at its ratio, as numbers and as samples, and buffers.
const BOUND: usize = 64 << 20;

/// Opens a damaged file alone, or paired with itself if it has one channel; it may be sound still, or must be refused
/// with its name.
fn survives(path: &Path, bytes: &[u8], what: &str) -> bool {
    std::fs::write(path, bytes).unwrap();
    let options = |second: Option<&Path>| OpenOptions {
        second: second.map(Path::to_owned),
        channels: ChannelOptions {
            channels: Some([ChannelRef::Number(1), ChannelRef::Number(2)]),
            probe: Some([1.0, 1.0]),
            ..ChannelOptions::default()
        },
        ..OpenOptions::default()
    };
    let (alone, of_alone) = peak(path, &options(None));
    let has_one = |e: &CaptureError| e.to_string().contains("no channel 2");
    let (result, taken) = match alone.as_ref().is_err_and(has_one) {
        true => peak(path, &options(Some(path))),
        false => (alone, of_alone),
    };
    assert!(taken < BOUND, "{what}: {taken} bytes");
    match result {
        Ok(capture) => {
            assert_eq!(capture.v_v.len(), capture.i_a.len(), "{what}");
            true
        }
        Err(e) => {
            let text = e.to_string();
            assert!(text.contains("damaged."), "{what}: {text}");
            false
        }
    }
}

/// Returns `true` if a MAT file's first `length` bytes end with an element.
fn ends_an_element(bytes: &[u8], length: usize) -> bool {
    let mut at = 128;
    while at < length {
        let size: [u8; 4] = bytes[at + 4..at + 8].try_into().unwrap();
        at += 8 + u32::from_le_bytes(size) as usize;
    }
    at == length
}

#[test]
fn truncated_files_are_refused_or_shorter() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    for fixture in fixtures() {
        let bytes = std::fs::read(&fixture).unwrap();
        let ending = fixture.extension().unwrap().to_string_lossy().into_owned();
        let path = folder.path().join(format!("damaged.{ending}"));
        let name = fixture.file_name().unwrap().display();
        assert!(survives(&path, &bytes, "whole"), "{name}");
        let mut lengths: Vec<usize> = (0..bytes.len()).step_by(bytes.len().div_ceil(41)).collect();
        lengths.extend(
            [1, 2, 9, 11, bytes.len() - 1]
                .into_iter()
                .filter(|n| *n < bytes.len()),
        );
        for length in lengths {
            let sound = survives(&path, &bytes[..length], &format!("{name} cut to {length}"));
            // Binary formats declare their length: a cut in the samples cannot pass. WFM and ISF end
            // with bytes that are not samples; a table may be cut after any row, MAT between arrays.
            let at_end = bytes.len() - length < 200;
            let whole = ending == "csv" || ending == "mat" && ends_an_element(&bytes, length);
            assert!(!sound || whole || at_end, "{name} cut to {length}");
        }
    }
}

#[test]
fn changed_bytes_never_panic_and_memory_stays_bounded() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    for (seed, fixture) in fixtures().iter().enumerate() {
        let bytes = std::fs::read(fixture).unwrap();
        let ending = fixture.extension().unwrap().to_string_lossy().into_owned();
        let path = folder.path().join(format!("damaged.{ending}"));
        let name = fixture.file_name().unwrap().display();
        let mut random = ChaCha8Rng::seed_from_u64(seed as u64);
        for round in 0..40 {
            let mut changed = bytes.clone();
            for _ in 0..random.random_range(1..8) {
                // Headers matter more than samples: half of the changes are at the beginning.
                let to = if random.random() {
                    bytes.len()
                } else {
                    bytes.len().min(1024)
                };
                let at = random.random_range(0..to);
                changed[at] = random.next_u32() as u8;
            }
            survives(&path, &changed, &format!("{name}, round {round}"));
        }
    }
}

#[test]
fn hostile_lengths_never_allocate() {
    let _turn = turn();
    let folder = tempfile::tempdir().unwrap();
    for fixture in fixtures() {
        let ending = fixture.extension().unwrap().to_string_lossy().into_owned();
        if ending == "csv" {
            continue;
        }
        let bytes = std::fs::read(&fixture).unwrap();
        let path = folder.path().join(format!("damaged.{ending}"));
        let name = fixture.file_name().unwrap().display();
        // The largest positive 32-bit number and 2^60, in the file's byte order.
        let big = name.to_string().contains("be_");
        let patterns: [&[u8]; 2] = if big {
            [&[0x7F, 0xFF, 0xFF, 0xFF], &[0x10, 0, 0, 0, 0, 0, 0, 0]]
        } else {
            [&[0xFF, 0xFF, 0xFF, 0x7F], &[0, 0, 0, 0, 0, 0, 0, 0x10]]
        };
        // Fields are where the headers have them: at even offsets, in TRC behind 11 more bytes. The
        // directory of a ZIP archive stands at the end.
        let head = 0..bytes.len().min(840);
        let tail = bytes.len().saturating_sub(300)..bytes.len();
        let places: Vec<usize> = match ending.as_str() {
            "wfm" => head.step_by(2).collect(),
            "npz" => head.step_by(16).chain(tail.step_by(2)).collect(),
            "mat" => (128..bytes.len())
                .step_by(if bytes.len() > 5000 { 64 } else { 8 })
                .collect(),
            "trc" => head.step_by(2).chain((11..360).step_by(2)).collect(),
            _ => head.step_by(8).collect(),
        };
        for at in places {
            for pattern in patterns {
                let mut changed = bytes.clone();
                let end = (at + pattern.len()).min(changed.len());
                changed[at..end].copy_from_slice(&pattern[..end - at]);
                survives(&path, &changed, &format!("{name}, {pattern:02x?} at {at}"));
            }
        }
    }
}
