//! Events arrive; a slow client is sent the number of missed events.

use std::io::{Read, Write};
use std::sync::Arc;

use ihd_api::ApiClient;
use ihd_api::client::events::StreamItem;
use ihd_daemon::model::{DaemonEvent, EventKind};

use crate::backend::Running;
use crate::http::connect;

fn stored(device: &str, seq: u32) -> Arc<DaemonEvent> {
    Arc::new(DaemonEvent {
        at_ms: 1_700_000_000_000,
        device: device.into(),
        kind: EventKind::WindowStored { boot: 7, seq },
    })
}

fn client(server: &Running) -> ApiClient {
    ApiClient::new(&server.url, "test", None, None).unwrap()
}

/// Returns the next item that is not a heartbeat.
fn next(events: &mut ihd_api::client::events::Events) -> StreamItem {
    loop {
        match events.next().expect("not ended").expect("no error") {
            StreamItem::Heartbeat => {}
            other => return other,
        }
    }
}

#[test]
fn notices_arrive_in_order_and_the_filter_holds() {
    let server = Running::start();
    let mut all = client(&server).events(None).unwrap();
    let mut bench = client(&server).events(Some("bench ä")).unwrap();
    // Subscribed once the greeting is there.
    assert_eq!(all.next().unwrap().unwrap(), StreamItem::Heartbeat);
    assert_eq!(bench.next().unwrap().unwrap(), StreamItem::Heartbeat);
    for (device, seq) in [
        ("kitchen", 1),
        ("bench ä", 2),
        ("", 3),
        ("kitchen", 4),
        ("bench ä", 5),
    ] {
        server.fake.notices.send(stored(device, seq)).unwrap();
    }
    let seqs = |events: &mut _, n| -> Vec<u32> {
        (0..n)
            .map(|_| match next(events) {
                StreamItem::Event(notice) => match notice.kind {
                    EventKind::WindowStored { seq, .. } => seq,
                    other => panic!("{other:?}"),
                },
                other => panic!("{other:?}"),
            })
            .collect()
    };
    assert_eq!(seqs(&mut all, 5), [1, 2, 3, 4, 5]);
    assert_eq!(seqs(&mut bench, 3), [2, 3, 5]);
}

#[test]
fn a_slow_reader_is_told_and_everything_is_accounted_for() {
    let server = Running::start();
    let mut events = client(&server).events(None).unwrap();
    assert_eq!(events.next().unwrap().unwrap(), StreamItem::Heartbeat);
    // More than sockets, queue and channel can buffer.
    const SENT: u64 = 200_000;
    for seq in 0..SENT {
        server
            .fake
            .notices
            .send(stored("bench", seq as u32))
            .unwrap();
    }
    let (mut received, mut missed) = (0, 0);
    while received + missed < SENT {
        match next(&mut events) {
            StreamItem::Event(_) => received += 1,
            StreamItem::Missed(n) => missed += n,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(received + missed, SENT);
    assert!(
        missed > 0 && received > 0,
        "{received} received, {missed} missed"
    );
}

#[test]
fn the_end_of_the_server_ends_the_events_at_once() {
    let (server, _clock) = Running::with_clock();
    let mut events = client(&server).events(None).unwrap();
    assert_eq!(events.next().unwrap().unwrap(), StreamItem::Heartbeat);
    // At once: its clock is paused.
    server.stop();
    assert!(events.next().is_none());
}

#[test]
fn who_comes_back_is_told_that_nothing_was_kept() {
    let server = Running::start();
    let mut stream = connect(server.address);
    stream
        .write_all(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 7\r\n\r\n")
        .unwrap();
    let mut text = String::new();
    let mut buffer = [0; 1024];
    while !text.contains("nothing is kept") {
        let n = stream.read(&mut buffer).unwrap();
        assert!(n > 0, "{text}");
        text += std::str::from_utf8(&buffer[..n]).unwrap();
    }
    assert!(text.contains("text/event-stream"), "{text}");
}
