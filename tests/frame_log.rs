//! Recordings: what comes back is what came over the link, damage included.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use ihd::capture::frames::{FrameLog, FrameLogError, FrameLogReader};
use ihd::link::{Client, Counters, Event, FrameSink, LinkError};
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use proptest::prelude::*;
use tempfile::TempDir;

/// A device that heats and streams, its recording, and the events the client saw meanwhile.
fn record(path: &Path) -> (Vec<Event>, Counters) {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut client = Client::connect(Box::new(link.clone())).unwrap();
    client.set_power(1_000).unwrap();
    link.hob().run(60);
    client.record_to(FrameLog::create(path, client.hello()).unwrap());
    client.stream(1, 2).unwrap();
    let mut events = Vec::new();
    while events.len() < 12 {
        events.extend(client.next_event(Duration::from_millis(100)).unwrap());
    }
    client.stream(0, 0).unwrap();
    while let Some(event) = client.next_event(Duration::from_millis(50)).unwrap() {
        events.push(event);
    }
    (events, client.counters())
}

fn read(path: &Path) -> (Vec<Event>, FrameLogReader) {
    let mut reader = FrameLogReader::open(path).unwrap();
    let mut events = Vec::new();
    while let Some(event) = reader.next_event().unwrap() {
        events.push(event);
    }
    (events, reader)
}

/// A recording's bytes and events, made once.
static RECORDING: LazyLock<(Vec<u8>, Vec<Event>)> = LazyLock::new(|| {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("whole.ihdframes");
    let (events, _) = record(&path);
    (fs::read(path).unwrap(), events)
});

/// A file with the given bytes.
fn file(dir: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join("changed.ihdframes");
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn what_comes_back_is_what_the_client_saw() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("hob.ihdframes");
    let (live, seen) = record(&path);
    let (events, reader) = read(&path);
    assert!(live.iter().any(|e| matches!(e, Event::Window(_))));
    assert_eq!(events, live);
    assert_eq!(reader.hello(), &desk_hello());
    let counters = reader.counters();
    assert_eq!((counters.frames_bad, counters.frames_lost), (0, 0));
    assert_eq!(counters.windows.received, seen.windows.received);
    assert_eq!(counters.telemetry, seen.telemetry);
    assert_eq!(reader.first_damage(), None);
}

#[test]
fn a_recording_is_never_overwritten() {
    let dir = TempDir::new().unwrap();
    let path = file(&dir, b"precious");
    let Err(error) = FrameLog::create(&path, &desk_hello()) else {
        panic!("it must not be created");
    };
    assert!(matches!(error, FrameLogError::Exists { .. }));
    assert!(error.to_string().contains("changed.ihdframes"), "{error}");
    assert_eq!(fs::read(path).unwrap(), b"precious");
}

#[test]
fn a_flipped_bit_is_found_with_its_place_and_costs_one_frame() {
    let (bytes, whole) = &*RECORDING;
    let dir = TempDir::new().unwrap();
    let mut bytes = bytes.clone();
    let at = bytes.len() / 2;
    bytes[at] ^= 0x40;
    let (events, reader) = read(&file(&dir, &bytes));
    let damage = reader.first_damage().unwrap();
    let at = at as u64;
    assert!(
        damage.offset <= at && at < damage.offset + 1_100,
        "{damage:?}"
    );
    assert!(reader.counters().frames_bad >= 1);
    let unchanged = events.iter().filter(|e| whole.contains(e)).count();
    assert!(
        unchanged + 1 >= whole.len(),
        "{unchanged} of {}",
        whole.len()
    );
}

#[test]
fn what_is_no_recording_says_so() {
    let dir = TempDir::new().unwrap();
    let (bytes, _) = &*RECORDING;
    let hello_end = 1 + bytes[1..].iter().position(|&b| b == 0).unwrap();
    let contents: [&[u8]; 5] = [
        b"",
        b"time,v,i\n0,1,2\n",
        &[b'x'; 10_000],
        &[0; 10_000],
        // A recording without its hello.
        &bytes[hello_end + 1..],
    ];
    for content in contents {
        let path = file(&dir, content);
        let Err(error) = FrameLogReader::open(&path) else {
            panic!("{} bytes must not open", content.len());
        };
        assert!(
            matches!(error, FrameLogError::NotARecording { .. }),
            "{error}"
        );
        assert!(error.to_string().contains("changed.ihdframes"), "{error}");
    }
    let missing = FrameLogReader::open(&dir.path().join("missing"))
        .err()
        .unwrap();
    assert!(
        missing.to_string().contains("missing at byte 0"),
        "{missing}"
    );
}

#[test]
fn a_recording_of_another_major_or_of_a_host_is_refused() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("other");
    let mut hello = desk_hello();
    hello.protocol_major = PROTOCOL_MAJOR + 1;
    FrameLog::create(&path, &hello).unwrap();
    let error = FrameLogReader::open(&path).err().unwrap();
    assert!(matches!(error, FrameLogError::Mismatch { .. }), "{error}");
    let path = dir.path().join("host");
    FrameLog::create(&path, &ours(ROLE_HOST, 0, 0, "", "")).unwrap();
    let error = FrameLogReader::open(&path).err().unwrap();
    assert!(
        matches!(error, FrameLogError::NotARecording { .. }),
        "{error}"
    );
}

/// A sink that is full from the beginning.
struct Full;

impl FrameSink for Full {
    fn append(&mut self, _: &[u8]) -> std::io::Result<()> {
        Err(std::io::ErrorKind::StorageFull.into())
    }
}

#[test]
fn a_full_disk_is_told_once_and_the_link_goes_on() {
    let link = DeskLink::new(DeskHob::new(desk_hello()));
    let mut client = Client::connect(Box::new(link)).unwrap();
    client.record_to(Full);
    client.stream(1, 0).unwrap();
    let told = client.next_event(Duration::from_millis(50));
    assert!(matches!(told, Err(LinkError::Recording(_))), "{told:?}");
    for _ in 0..3 {
        let event = client.next_event(Duration::from_millis(50)).unwrap();
        assert!(matches!(event, Some(Event::Telemetry(_))));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A recorder killed at any byte leaves every event that was complete by then.
    #[test]
    fn a_file_cut_anywhere_reads_up_to_the_cut(at in any::<prop::sample::Index>()) {
        let (bytes, whole) = &*RECORDING;
        let hello_end = 2 + bytes[1..].iter().position(|&b| b == 0).unwrap();
        let cut = hello_end + at.index(bytes.len() - hello_end);
        let dir = TempDir::new().unwrap();
        let (mut events, reader) = read(&file(&dir, &bytes[..cut]));
        prop_assert!(reader.counters().frames_bad <= 1);
        if let Some(Event::WindowRejected { reason, .. }) = events.last() {
            prop_assert_eq!(reason.label(), "no end");
            events.pop();
        }
        prop_assert_eq!(&events[..], &whole[..events.len()]);
    }
}
