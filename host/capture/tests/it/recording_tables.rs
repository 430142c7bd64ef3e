//! A recording as tables and arrays, against the same file read as a capture and as a session.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use ihd_capture::exports::recording::{
    ExportLimits, RecordingExportError, half_cycles_csv, recording_npz, samples_csv,
};
use ihd_capture::mcap::{self, SessionReader, SessionRecorder};
use ihd_capture::{OpenOptions, open};
use ihd_link::{Client, DeviceEvent};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

/// When the trigger of the test's recording came.
const TRIGGER_S: f64 = 0.75;

static NEVER: AtomicBool = AtomicBool::new(false);

fn generous(stop: &AtomicBool) -> ExportLimits<'_> {
    ExportLimits {
        bytes: 1 << 30,
        until: Instant::now() + Duration::from_secs(300),
        stop,
    }
}

/// A second and a half of a hob that heats, or is asked for nothing.
fn recorded(dir: &Path, power_w: u16) -> PathBuf {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = Client::connect(Box::new(hob)).unwrap();
    client.set_power(power_w).unwrap();
    client.stream(1, 20).unwrap();
    let path = dir.join("recorded.mcap");
    let notes = BTreeMap::from([("trigger_s".to_owned(), TRIGGER_S.to_string())]);
    let (hello, front_end) = (client.hello(), client.front_end());
    let recorder = SessionRecorder::with_notes(&path, hello, front_end, notes).unwrap();
    client.record_to(recorder.starting_at(client.clock()));
    let until = client.clock() + Duration::from_millis(1_500);
    while client.clock() < until {
        client.next_event(until - client.clock()).unwrap();
    }
    client.finish_recording().unwrap();
    path
}

#[test]
fn the_samples_are_those_of_the_capture_with_the_windows_numbers_and_the_triggers_time() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path(), 1_000);
    let capture = mcap::read(&path).unwrap();
    let mut numbers = BTreeMap::new();
    let mut session = SessionReader::open(&path).unwrap();
    while let Some(event) = session.next_event().unwrap() {
        if let DeviceEvent::Window(window) = event {
            numbers.insert(window.seq, window.pairs.len());
        }
    }
    assert!(numbers.len() >= 5, "{numbers:?}");
    let mut text = Vec::new();
    samples_csv(&path, &mut text, &generous(&NEVER)).unwrap();
    let text = String::from_utf8(text).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time_s,v_V,i_A,window"));
    let mut seen: BTreeMap<u32, usize> = BTreeMap::new();
    for (k, line) in lines.enumerate() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let t_s = capture.time.at(k).unwrap() - TRIGGER_S;
        assert!((cells[0] - t_s).abs() < 1e-10, "{line} at {t_s}");
        assert_eq!(
            (cells[1] as f32, cells[2] as f32),
            (capture.v_v[k], capture.i_a[k])
        );
        *seen.entry(cells[3] as u32).or_default() += 1;
    }
    assert_eq!(seen, numbers);
    // Whatever opens a capture opens it.
    let table = dir.path().join("a.csv");
    std::fs::write(&table, &text).unwrap();
    let again = open(&table, &OpenOptions::default()).unwrap();
    assert!(again.v_v == capture.v_v && again.i_a == capture.i_a);
}

#[test]
fn half_cycles_are_a_line_each() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path(), 1_000);
    let mut text = Vec::new();
    half_cycles_csv(&path, &mut text, &generous(&NEVER)).unwrap();
    let text = String::from_utf8(text).unwrap();
    let lines: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
    let column = |name: &str| lines[0].iter().position(|n| *n == name).unwrap();
    let (time, power, state, r) = (
        column("time_s"),
        column("power_W"),
        column("state"),
        column("R_ohm"),
    );
    assert!(lines[1..].len().abs_diff(150) < 5, "{}", lines.len());
    assert!(lines.iter().all(|line| line.len() == lines[0].len()));
    let number = |line: &[&str], k: usize| line[k].parse::<f64>().unwrap();
    let first = number(&lines[1], time);
    assert!((first + TRIGGER_S).abs() < 0.03, "{first}");
    let last = lines.last().unwrap();
    assert_eq!(last[state], "Heating");
    // A kilowatt was asked for, of a load of some ohms.
    assert!((number(last, power) - 1_000.0).abs() < 100.0, "{last:?}");
    assert!((0.5..10.0).contains(&number(last, r)), "{last:?}");
}

/// Writes a recording as arrays; returns the archive's path.
fn packed(recording: &Path, archive: &Path) -> PathBuf {
    let folder = archive.parent().unwrap();
    let spool = || tempfile::tempfile_in(folder);
    let out = File::create(archive).unwrap();
    recording_npz(recording, out, &spool, &generous(&NEVER)).unwrap();
    archive.to_owned()
}

/// Numbers of an array in an archive.
fn array(path: &Path, name: &str) -> (String, Vec<u8>) {
    let mut archive = zip::ZipArchive::new(File::open(path).unwrap()).unwrap();
    let mut bytes = Vec::new();
    let mut member = archive.by_name(&format!("{name}.npy")).unwrap();
    member.read_to_end(&mut bytes).unwrap();
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = String::from_utf8_lossy(&bytes[10..header]).into_owned();
    (text, bytes.split_off(header))
}

fn doubles(path: &Path, name: &str) -> Vec<f64> {
    let (header, bytes) = array(path, name);
    assert!(header.contains("'<f8'"), "{header}");
    let chunks = bytes.chunks_exact(8);
    chunks
        .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

#[test]
fn arrays_hold_samples_windows_and_half_cycles() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path(), 1_000);
    let capture = mcap::read(&path).unwrap();
    let packed = packed(&path, &dir.path().join("a.npz"));
    let times = doubles(&packed, "time_s");
    assert_eq!(times.len(), capture.len());
    let at = |k| capture.time.at(k).unwrap() - TRIGGER_S;
    assert!(
        times
            .iter()
            .enumerate()
            .all(|(k, t)| (t - at(k)).abs() < 1e-12)
    );
    let (header, v) = array(&packed, "v_V");
    assert!(
        header.contains(&format!("'shape': ({},)", capture.len())),
        "{header}"
    );
    assert!(
        v.chunks_exact(4)
            .zip(&capture.v_v)
            .all(|(b, v)| b == v.to_le_bytes())
    );
    let half_cycles = doubles(&packed, "half_cycle_t_s");
    assert_eq!(
        doubles(&packed, "half_cycle_r_ohm").len(),
        half_cycles.len()
    );
    let (header, states) = array(&packed, "half_cycle_state");
    assert!(header.contains("'<U24'"), "{header}");
    let last = states.chunks_exact(96).last().unwrap();
    let word = last
        .chunks_exact(4)
        .map(|b| char::from(b[0]))
        .take_while(|c| *c != '\0');
    assert_eq!(word.collect::<String>(), "Heating");
    let windows = doubles(&packed, "windows_t_s");
    assert!(
        windows.len() >= 5 && windows.windows(2).all(|w| w[1] > w[0]),
        "{windows:?}"
    );
    // A window lies where its half-cycle was, though it arrived later: that was over when its telemetry came.
    let numbers = |name: &str| -> Vec<u32> {
        let bytes = array(&packed, name).1;
        let chunks = bytes.chunks_exact(4);
        chunks
            .map(|b| u32::from_le_bytes(b.try_into().unwrap()))
            .collect()
    };
    let told = numbers("half_cycle_number");
    for (half_cycle, begins_s) in numbers("windows_half_cycle").into_iter().zip(&windows) {
        let Some(k) = told.iter().position(|n| *n == half_cycle) else {
            continue;
        };
        let late_s = begins_s + 0.01 - half_cycles[k];
        assert!((-0.01..0.01).contains(&late_s), "{half_cycle}: {late_s}");
    }
    // Our own readers take it for a capture, too.
    let again = open(&packed, &OpenOptions::default()).unwrap();
    assert!(again.v_v == capture.v_v && again.i_a == capture.i_a);
}

#[test]
fn a_hob_that_does_not_heat_has_half_cycles_and_no_samples() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path(), 0);
    let refused = samples_csv(&path, Vec::new(), &generous(&NEVER)).unwrap_err();
    assert!(
        matches!(refused, RecordingExportError::Nothing { .. }),
        "{refused}"
    );
    let mut text = Vec::new();
    half_cycles_csv(&path, &mut text, &generous(&NEVER)).unwrap();
    let text = String::from_utf8(text).unwrap();
    // Its R and L are empty, not zero.
    assert!(text.lines().last().unwrap().contains(",,"), "{text}");
}

#[test]
fn limits_hold_and_a_cut_file_gives_what_is_whole() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path(), 1_000);
    let whole = std::fs::read(&path).unwrap();
    let export = |limits: &ExportLimits<'_>| samples_csv(&path, Vec::new(), limits).unwrap_err();
    let small = ExportLimits {
        bytes: 10_000,
        ..generous(&NEVER)
    };
    assert!(matches!(
        export(&small),
        RecordingExportError::TooLarge { bytes: 10_000 }
    ));
    let spool = || tempfile::tempfile_in(dir.path());
    let npz = File::create(dir.path().join("a.npz")).unwrap();
    let refused = recording_npz(&path, npz, &spool, &small).unwrap_err();
    assert!(
        matches!(refused, RecordingExportError::TooLarge { .. }),
        "{refused}"
    );
    let late = ExportLimits {
        until: Instant::now() - Duration::from_millis(1),
        ..generous(&NEVER)
    };
    assert!(matches!(export(&late), RecordingExportError::TooLong));
    let stop = AtomicBool::new(true);
    assert!(matches!(
        export(&generous(&stop)),
        RecordingExportError::Stopped
    ));
    let lines = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let mut text = Vec::new();
        let losses = samples_csv(&path, &mut text, &generous(&NEVER)).unwrap();
        (text.iter().filter(|b| **b == b'\n').count(), losses)
    };
    let (all, nothing) = lines(&whole);
    assert!(nothing.is_none(), "{nothing}");
    let (some, cut) = lines(&whole[..whole.len() * 2 / 3]);
    assert!(some > 1_000 && some < all, "{some} of {all}");
    assert!(cut.cut_at.is_some() && cut.damaged == 0, "{cut}");
    let mut spoilt = whole.clone();
    let middle = whole.len() / 2;
    spoilt[middle..middle + 3].iter_mut().for_each(|b| *b = !*b);
    let (some, damage) = lines(&spoilt);
    assert!(some < all && damage.damaged == 1, "{damage}");
    // The arrays carry the losses along.
    let packed = packed(&path, &dir.path().join("damaged.npz"));
    let mut archive = zip::ZipArchive::new(File::open(&packed).unwrap()).unwrap();
    let mut notes = String::new();
    let mut member = archive.by_name("metadata.json").unwrap();
    member.read_to_string(&mut notes).unwrap();
    assert!(notes.contains("1 damaged records"), "{notes}");
}
