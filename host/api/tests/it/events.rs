//! Events arrive; a slow client is sent the number of missed events.

use ihd_api::ApiClient;
use ihd_api::client::events::{Events, StreamItem};
use ihd_model::EventKind;

use crate::rig::{NAME, OTHER, Running};

fn client(server: &Running) -> ApiClient {
    ApiClient::new(&server.url, "test", None, &[]).unwrap()
}

/// Returns the next item that is not a heartbeat.
fn next(events: &mut Events) -> StreamItem {
    loop {
        match events.next().expect("not ended").expect("no error") {
            StreamItem::Heartbeat => {}
            other => return other,
        }
    }
}

/// Returns the holders of the next `n` leases.
fn holders(events: &mut Events, n: usize) -> Vec<String> {
    let mut holders = Vec::new();
    while holders.len() < n {
        match next(events) {
            StreamItem::Event(event) => {
                if let EventKind::Lease { holder, .. } = event.kind {
                    holders.push(holder);
                }
            }
            other => panic!("{other:?}"),
        }
    }
    holders
}

#[test]
fn notices_arrive_in_order_and_the_filter_holds() {
    let server = Running::start();
    let mut all = client(&server).events(None).unwrap();
    let mut first = client(&server).events(Some(NAME)).unwrap();
    // Subscribed once the greeting is there.
    assert_eq!(all.next().unwrap().unwrap(), StreamItem::Heartbeat);
    assert_eq!(first.next().unwrap().unwrap(), StreamItem::Heartbeat);
    for (device, holder) in [
        (OTHER, "1"),
        (NAME, "2"),
        (OTHER, "3"),
        (NAME, "4"),
        (NAME, "5"),
    ] {
        server.take_lease(device, holder);
    }
    assert_eq!(holders(&mut all, 5), ["1", "2", "3", "4", "5"]);
    assert_eq!(holders(&mut first, 3), ["2", "4", "5"]);
}

#[test]
fn a_slow_reader_is_told_and_everything_is_accounted_for() {
    let (server, clock) = Running::with_clock();
    // Both devices are known to be unplugged: no event but these.
    clock.second();
    let mut events = client(&server).events(None).unwrap();
    assert_eq!(events.next().unwrap().unwrap(), StreamItem::Heartbeat);
    // More than sockets, queue and event bus can buffer.
    const SENT: u64 = 200_000;
    for _ in 0..SENT / 2 {
        server.take_lease(NAME, "Ada");
        server.release_lease(NAME, "Ada");
    }
    let (mut received, mut missed) = (0, 0);
    while received + missed < SENT {
        match next(&mut events) {
            StreamItem::Event(event) => {
                assert!(matches!(event.kind, EventKind::Lease { .. }), "{event:?}");
                received += 1;
            }
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
