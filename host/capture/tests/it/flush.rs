//! Content of a file whose recorder was killed.

use std::path::Path;
use std::time::{Duration, Instant};

use ihd_capture::mcap::reader::McapItem;
use ihd_capture::mcap::topics::Topic;
use ihd_capture::mcap::{McapReader, SessionRecorder};
use ihd_link::{Client, FrameSink};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

/// Messages of the device that are in the file by now, the hello aside.
fn in_file(path: &Path) -> usize {
    let mut reader = McapReader::open(path).unwrap();
    let mut seen = 0;
    while let Some(item) = reader.next_item().unwrap() {
        seen += usize::from(matches!(item, McapItem::Message(m) if m.topic == Topic::FromDevice));
    }
    seen.saturating_sub(1)
}

fn recorder(path: &Path) -> SessionRecorder {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let client = Client::connect(Box::new(hob)).unwrap();
    SessionRecorder::create(path, client.hello(), client.front_end()).unwrap()
}

#[test]
fn on_a_link_what_came_last_is_in_the_file_within_a_second_though_nothing_follows() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut recorder = recorder(&path).with_wall_clock_flush();
    // The transport's clock stands still: nothing but the wall's can flush.
    recorder.received(Duration::ZERO, &[1, 2, 3, 0]).unwrap();
    assert_eq!(in_file(&path), 0);
    let began = Instant::now();
    while in_file(&path) == 0 {
        assert!(
            began.elapsed() < Duration::from_secs(300),
            "it is not flushed"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    // Killed here, it would be in the file; ended in order it is too.
    recorder.received(Duration::ZERO, &[4, 0]).unwrap();
    Box::new(recorder).finish().unwrap();
    assert_eq!(in_file(&path), 2);
}

#[test]
fn in_simulated_time_the_simulated_clock_alone_flushes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut recorder = recorder(&path);
    recorder.received(Duration::ZERO, &[1, 0]).unwrap();
    std::thread::sleep(Duration::from_millis(800));
    assert_eq!(in_file(&path), 0);
    recorder
        .received(Duration::from_millis(250), &[2, 0])
        .unwrap();
    assert_eq!(in_file(&path), 2);
}
