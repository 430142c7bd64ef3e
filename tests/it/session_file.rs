//! Recorded sessions: what comes back is what came over the link, damage included.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use ihd_capture::mcap;
use ihd_capture::mcap::{McapFileError, SessionReader, SessionRecorder};
use ihd_firmware::link::response::front_end;
use ihd_link::{Client, ClientCounters, DeviceEvent, FrameSink, LinkError, Window};
use ihd_shared::sampling::VOLT_PER_CODE;
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_signal::TimeBase;
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use proptest::prelude::*;
use tempfile::TempDir;

/// Half-cycles recorded: 1.5 s, three chunks and a rest.
const HALF_CYCLES: usize = 160;

/// A device that heats and streams, its recording, and the events the client saw meanwhile.
fn record(path: &Path) -> (Vec<DeviceEvent>, ClientCounters) {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut client = Client::connect(Box::new(link.clone())).unwrap();
    client.set_power(1_000).unwrap();
    link.hob().run(60);
    client.record_to(SessionRecorder::create(path, client.hello(), client.front_end()).unwrap());
    client.stream(1, 20).unwrap();
    let mut events = Vec::new();
    while events.len() < HALF_CYCLES {
        events.extend(client.next_event(Duration::from_millis(100)).unwrap());
    }
    client.stream(0, 0).unwrap();
    while let Some(event) = client.next_event(Duration::from_millis(50)).unwrap() {
        events.push(event);
    }
    client.finish_recording().unwrap();
    (events, client.counters())
}

fn read(path: &Path) -> (Vec<DeviceEvent>, SessionReader) {
    let mut reader = SessionReader::open(path).unwrap();
    let mut events = Vec::new();
    while let Some(event) = reader.next_event().unwrap() {
        events.push(event);
    }
    // The end is the end, however often one asks.
    assert!(reader.next_event().unwrap().is_none());
    (events, reader)
}

/// A recording's bytes and events, and the size of its beginning, made once.
static RECORDING: LazyLock<(Vec<u8>, Vec<DeviceEvent>, usize)> = LazyLock::new(|| {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("whole.mcap");
    let (events, _) = record(&path);
    let begun = dir.path().join("begun.mcap");
    let recorder = SessionRecorder::create(&begun, &desk_hello(), &front_end()).unwrap();
    let beginning = fs::metadata(&begun).unwrap().len() as usize;
    drop(recorder);
    (fs::read(path).unwrap(), events, beginning)
});

/// A file with the given bytes.
fn file(dir: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join("changed.mcap");
    fs::write(&path, bytes).unwrap();
    path
}

fn windows(events: &[DeviceEvent]) -> Vec<&Window> {
    let mut windows = Vec::new();
    for event in events {
        if let DeviceEvent::Window(window) = event {
            windows.push(&**window);
        }
    }
    windows
}

#[test]
fn what_comes_back_is_what_the_client_saw() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("hob.mcap");
    let (live, seen) = record(&path);
    let (events, reader) = read(&path);
    assert!(windows(&live).len() > 5);
    assert!(events == live, "{} and {}", events.len(), live.len());
    assert_eq!(reader.hello(), &desk_hello());
    let counters = reader.counters();
    assert_eq!((counters.frames_bad, counters.frames_lost), (0, 0));
    assert_eq!(counters.windows.received, seen.windows.received);
    assert_eq!(counters.telemetry, seen.telemetry);
    assert_eq!(reader.first_damage(), None);
    assert!(reader.file_damage().is_none() && !reader.is_cut());
}

#[test]
fn the_windows_of_a_session_are_a_capture() {
    let (bytes, events, _) = &*RECORDING;
    let dir = TempDir::new().unwrap();
    let capture = mcap::read(&file(&dir, bytes)).unwrap();
    let windows = windows(events);
    let pairs: Vec<_> = windows.iter().flat_map(|w| &w.pairs).collect();
    assert_eq!(capture.len(), pairs.len());
    for (k, pair) in pairs.iter().enumerate() {
        let v_v = (f64::from(pair.v) * VOLT_PER_CODE) as f32;
        assert_eq!(capture.v_v[k], v_v, "pair {k}");
    }
    assert_eq!(capture.f_sw.len(), 1, "it heats at one frequency");
    assert_eq!(capture.f_sw[0].f_sw_hz, f64::from(windows[0].f_sw_hz));
    assert!((capture.mains_hz.unwrap() - 50.0).abs() < 0.1);
    // Each window lies at its own half-cycle after the first one's.
    let TimeBase::Stamps(t_s) = &capture.time else {
        panic!("there are gaps between windows");
    };
    let zero_s = capture.zero_crossing_s.unwrap();
    let mut first = 0;
    for window in &windows {
        let half_cycles = window.half_cycle - windows[0].half_cycle;
        let due_s = zero_s + f64::from(half_cycles) * 10e-3 + window.pair_time_s(0);
        // A half-cycle of the desk ends with the block after 10 ms.
        let late_s = t_s[first] - due_s;
        assert!(late_s.abs() < 1e-6 * f64::from(half_cycles + 1), "{late_s}");
        first += window.pairs.len();
    }
    assert_eq!(capture.metadata["device_board"], "desk");
}

#[test]
fn a_recording_is_never_overwritten() {
    let dir = TempDir::new().unwrap();
    let path = file(&dir, b"precious");
    let Err(error) = SessionRecorder::create(&path, &desk_hello(), &front_end()) else {
        panic!("it must not be created");
    };
    assert!(matches!(error, McapFileError::Exists { .. }));
    assert!(error.to_string().contains("changed.mcap"), "{error}");
    assert_eq!(fs::read(path).unwrap(), b"precious");
}

#[test]
fn a_flipped_bit_is_found_with_its_place_and_costs_one_chunk() {
    let (bytes, whole, _) = &*RECORDING;
    let dir = TempDir::new().unwrap();
    let mut bytes = bytes.clone();
    let at = bytes.len() / 2;
    bytes[at] ^= 0x40;
    let (events, reader) = read(&file(&dir, &bytes));
    let Some(McapFileError::Damaged { offset, .. }) = reader.file_damage() else {
        panic!("not found: {:?}", reader.file_damage());
    };
    assert!(*offset <= at as u64, "{offset} > {at}");
    // A chunk is half a second, and the window that it cuts.
    let unchanged = events.iter().filter(|e| whole.contains(e)).count();
    assert!(unchanged + 60 >= whole.len() && unchanged < whole.len());
    assert_eq!(
        events.last(),
        whole.last(),
        "what follows the damage is read"
    );
    let error = mcap::read(&file(&dir, &bytes)).unwrap_err().to_string();
    assert!(
        error.contains(&format!("changed.mcap at byte {offset}")),
        "{error}"
    );
}

/// Within a chunk's head, whose length is there and whose bytes are not.
#[test]
fn a_file_cut_in_a_chunks_head_ends_there() {
    let (bytes, _, beginning) = &*RECORDING;
    let dir = TempDir::new().unwrap();
    for cut in *beginning..beginning + 32 {
        let (events, reader) = read(&file(&dir, &bytes[..cut]));
        assert!(events.is_empty() && reader.is_cut(), "{cut}");
    }
}

#[test]
fn what_is_no_session_says_so() {
    let dir = TempDir::new().unwrap();
    let (bytes, ..) = &*RECORDING;
    let contents: [&[u8]; 5] = [
        b"",
        b"time,v,i\n0,1,2\n",
        &[b'x'; 10_000],
        &[0; 10_000],
        &bytes[1..],
    ];
    for content in contents {
        let error = SessionReader::open(&file(&dir, content)).err().unwrap();
        assert!(matches!(error, McapFileError::NotMcap { .. }), "{error}");
        assert!(error.to_string().contains("changed.mcap"), "{error}");
    }
    let missing = SessionReader::open(&dir.path().join("missing"))
        .err()
        .unwrap();
    assert!(
        missing.to_string().contains("missing at byte 0"),
        "{missing}"
    );
    // A capture that no device sent.
    let capture = mcap::read(&file(&dir, bytes)).unwrap();
    let path = dir.path().join("samples.mcap");
    mcap::write(&capture, &path).unwrap();
    let error = SessionReader::open(&path).err().unwrap();
    assert!(matches!(error, McapFileError::Missing { .. }), "{error}");
}

#[test]
fn a_recording_of_another_major_or_of_a_host_is_refused() {
    let dir = TempDir::new().unwrap();
    let mut hello = desk_hello();
    for other in [PROTOCOL_MAJOR - 1, PROTOCOL_MAJOR + 1] {
        hello.protocol_major = other;
        let path = dir.path().join(other.to_string());
        drop(SessionRecorder::create(&path, &hello, &front_end()).unwrap());
        let error = SessionReader::open(&path).err().unwrap();
        assert!(matches!(error, McapFileError::Mismatch { .. }), "{error}");
        assert!(
            error.to_string().contains(&format!("version {other} ")),
            "{error}"
        );
    }
    let path = dir.path().join("host");
    drop(SessionRecorder::create(&path, &ours(ROLE_HOST, 0, 0, "", ""), &front_end()).unwrap());
    let error = SessionReader::open(&path).err().unwrap();
    assert!(matches!(error, McapFileError::Missing { .. }), "{error}");
}

/// A sink that is full from the beginning.
struct Full;

impl FrameSink for Full {
    fn received(&mut self, _: Duration, _: &[u8]) -> std::io::Result<()> {
        Err(std::io::ErrorKind::StorageFull.into())
    }

    fn sent(&mut self, _: Duration, _: &[u8]) -> std::io::Result<()> {
        Ok(())
    }

    fn finish(self: Box<Self>) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_reported_once_and_the_link_goes_on() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut client = Client::connect(Box::new(link)).unwrap();
    client.record_to(Full);
    client.stream(1, 0).unwrap();
    let reported = client.next_event(Duration::from_millis(50));
    assert!(
        matches!(reported, Err(LinkError::Recording(_))),
        "{reported:?}"
    );
    for _ in 0..3 {
        let event = client.next_event(Duration::from_millis(50)).unwrap();
        assert!(matches!(event, Some(DeviceEvent::Telemetry(_))));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A recorder killed at any byte leaves every event up to the last chunk that was whole.
    #[test]
    fn a_file_cut_anywhere_reads_up_to_its_last_whole_chunk(at in any::<prop::sample::Index>()) {
        let (bytes, whole, beginning) = &*RECORDING;
        let cut = beginning + at.index(bytes.len() - beginning);
        let dir = TempDir::new().unwrap();
        let (mut events, reader) = read(&file(&dir, &bytes[..cut]));
        prop_assert!(reader.file_damage().is_none() && reader.counters().frames_bad <= 1);
        if let Some(DeviceEvent::WindowRejected { reason, .. }) = events.last() {
            prop_assert_eq!(reason.label(), "no end");
            events.pop();
        }
        prop_assert!(events[..] == whole[..events.len()]);
    }
}
