//! Live telemetry at the pace of the client: no old data, and losses are reported.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use ihd_daemon::model::{DaemonEvent, DeviceReport, EventKind, LiveDevice};
use serde::Deserialize as _;
use serde_json::Value;
use socket2::{Domain, Socket, Type};

use crate::backend::{Clock, NAME, Running, live};
use crate::http::{PATIENCE, ask, connect};

/// Events of `/live` with their names.
struct Watching(BufReader<TcpStream>);

impl Watching {
    fn start(server: &Running, query: &str) -> Self {
        Self::on(connect(server.address), query)
    }

    fn on(mut stream: TcpStream, query: &str) -> Self {
        let request = format!("GET /api/v1/live{query} HTTP/1.1\r\nHost: localhost\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        Self(BufReader::new(stream))
    }

    /// Returns the next event; `None` at the end.
    fn next(&mut self) -> Option<(String, Value)> {
        let (mut kind, mut line) = (String::new(), String::new());
        loop {
            line.clear();
            if self.0.read_line(&mut line).unwrap() == 0 {
                return None;
            }
            if let Some(name) = line.strip_prefix("event: ") {
                kind = name.trim().to_owned();
            }
            if let Some(data) = line.strip_prefix("data: ") {
                return Some((kind, serde_json::from_str(data).unwrap()));
            }
        }
    }

    /// Returns the next event of a name.
    fn next_of(&mut self, name: &str) -> Value {
        loop {
            let (kind, data) = self.next().expect("not ended");
            if kind == name {
                return data;
            }
        }
    }
}

fn stored(seq: u32) -> Arc<DaemonEvent> {
    let kind = EventKind::WindowStored { boot: 7, seq };
    let device = NAME.into();
    Arc::new(DaemonEvent {
        at_ms: 1,
        device,
        kind,
    })
}

/// Interval of telemetry in most of these tests.
const INTERVAL: Duration = Duration::from_millis(100);

/// Sets the number of devices that send telemetry.
fn devices(server: &Running, count: u64) {
    server.fake.world.devices.store(count, Ordering::Relaxed);
}

/// Lets an interval pass with ten half-cycles of each device; returns the half-cycles of each so far.
fn interval(server: &Running, clock: &Clock) -> u64 {
    let came = server
        .fake
        .world
        .half_cycles
        .fetch_add(10, Ordering::Relaxed);
    clock.pass(INTERVAL);
    came + 10
}

#[test]
fn a_report_that_changes_all_the_time_keeps_nothing_back() {
    let (server, clock) = Running::with_clock();
    server.fake.world.restless.store(true, Ordering::Relaxed);
    devices(&server, 1);
    let mut watching = Watching::start(&server, "?interval_ms=100");
    watching.next_of("devices");
    for _ in 0..10 {
        interval(&server, &clock);
        let mut both = [watching.next().unwrap().0, watching.next().unwrap().0];
        both.sort();
        assert_eq!(both, ["devices", "telemetry"]);
    }
}

#[test]
fn devices_come_first_and_telemetry_accounts_for_each_half_cycle() {
    let (server, clock) = Running::with_clock();
    let mut watching = Watching::start(&server, "?interval_ms=100");
    let (kind, reports) = watching.next().unwrap();
    assert_eq!(kind, "devices");
    let reports = Vec::<DeviceReport>::deserialize(reports).unwrap();
    assert_eq!(reports[0].name, NAME);
    devices(&server, 2);
    for _ in 0..30 {
        let came = interval(&server, &clock);
        let telemetry = watching.next_of("telemetry");
        let device = &telemetry["devices"]["device-001"];
        let device = LiveDevice::deserialize(device).unwrap();
        assert_eq!(u64::from(device.last.half_cycle), came);
        assert_eq!((device.half_cycles, device.skipped), (10, 0));
    }
}

#[test]
fn where_nobody_is_heard_something_comes_each_second_all_the_same() {
    // Reports are repeated every two seconds, at most once per interval.
    for (query, kinds) in [
        ("", &["telemetry", "devices", "telemetry", "devices"][..]),
        (
            "?interval_ms=5000",
            &[
                "telemetry",
                "telemetry",
                "telemetry",
                "telemetry",
                "devices",
            ],
        ),
    ] {
        let (server, clock) = Running::with_clock();
        let mut watching = Watching::start(&server, query);
        watching.next_of("devices");
        for kind in kinds {
            clock.pass(Duration::from_secs(1));
            let (came, data) = watching.next().unwrap();
            assert_eq!(came, *kind, "{query}: {data}");
            if came == "telemetry" {
                assert_eq!(data["devices"], serde_json::json!({}));
                assert!(data["at_ms"].as_i64() > Some(0));
            }
        }
    }
}

#[test]
fn what_changes_is_told_at_once_and_what_always_changes_is_not() {
    let (server, clock) = Running::with_clock();
    devices(&server, 1);
    let mut watching = Watching::start(&server, "?interval_ms=100");
    let first = watching.next_of("devices");
    assert!(first[0]["lease"].is_null());
    server.fake.asked.lock().unwrap().lease = Some("Ada".into());
    interval(&server, &clock);
    let (kind, second) = watching.next().unwrap();
    assert_eq!(kind, "devices");
    assert_eq!(second[0]["lease"]["holder"], "Ada");
    watching.next_of("telemetry");
    // `live` is another one each time; the next comes because 2 s are over.
    let kinds: Vec<_> = (0..20)
        .map(|_| {
            interval(&server, &clock);
            watching.next().unwrap().0
        })
        .collect();
    let first = kinds.iter().position(|kind| kind == "devices");
    assert_eq!(first, Some(19), "{kinds:?}");
}

#[test]
fn every_notice_but_telemetry_comes_in_order() {
    let (server, clock) = Running::with_clock();
    let mut watching = Watching::start(&server, "");
    watching.next_of("devices");
    for seq in 0..50 {
        server.fake.notices.send(stored(seq)).unwrap();
        let telemetry = DaemonEvent {
            at_ms: 1,
            device: NAME.into(),
            kind: EventKind::Telemetry { live: live(1) },
        };
        server.fake.notices.send(Arc::new(telemetry)).unwrap();
        // The channel of the fake holds 64 events: the server must empty it.
        clock.pass(Duration::ZERO);
    }
    for seq in 0..50 {
        let notice = watching.next_of("notice");
        assert_eq!(notice["event"], "window-stored");
        assert_eq!(notice["seq"], seq);
    }
}

/// Connects with a small receive buffer.
fn narrow(server: &Running) -> TcpStream {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
    socket.set_recv_buffer_size(8_192).unwrap();
    socket.connect(&server.address.into()).unwrap();
    let stream = TcpStream::from(socket);
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

#[test]
fn who_reads_nothing_costs_nothing_and_then_sees_what_is_new() {
    let (server, clock) = Running::with_clock();
    // 30 kB an event, 300 kB a second.
    devices(&server, 64);
    let mut watching = Watching::on(narrow(&server), "?interval_ms=100");
    watching.next_of("devices");
    let collections = || server.fake.world.collections.load(Ordering::Relaxed);
    // Until the buffers of both ends are full.
    let (mut before, mut unchanged, mut filling) = (collections(), 0, 0);
    while unchanged < 10 {
        interval(&server, &clock);
        filling += 1;
        assert!(filling < 100, "events are made that nobody takes");
        unchanged = if collections() == before {
            unchanged + 1
        } else {
            0
        };
        before = collections();
    }
    let mut came = 0;
    for _ in 0..60 {
        came = interval(&server, &clock);
    }
    let made = collections() - before;
    assert!(made <= 2, "{made} events were made that nobody took");
    // Notices meanwhile: those that do not fit the queue are counted.
    let mut sent = 0;
    for seq in 0..1_000 {
        server.fake.notices.send(stored(seq)).unwrap();
        sent += 1;
        if seq % 16 == 0 {
            clock.pass(Duration::ZERO);
        }
    }
    // From now on the clock advances by itself, so that the server sees that the socket is writable again.
    let is_read = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&is_read);
    let going_on = std::thread::spawn(move || {
        while !ends.load(Ordering::Relaxed) {
            clock.pass(INTERVAL);
            sleep(Duration::from_millis(20));
        }
    });
    let (mut old, mut half_cycles, mut skipped) = (0, 0, 0);
    let (mut notices, mut missed) = (0, 0);
    while half_cycles < came || notices + missed < sent {
        let (kind, data) = watching.next().unwrap();
        match kind.as_str() {
            "telemetry" => {
                let device = &data["devices"]["device-000"];
                if device.is_null() {
                    continue;
                }
                let device = LiveDevice::deserialize(device).unwrap();
                half_cycles += device.half_cycles;
                skipped += device.skipped;
                old += u32::from(u64::from(device.last.half_cycle) < came);
            }
            "notice" => notices += 1,
            "missed" => missed += data["missed"].as_u64().unwrap(),
            _ => {}
        }
    }
    is_read.store(true, Ordering::Relaxed);
    going_on.join().unwrap();
    assert_eq!(half_cycles, came, "each half-cycle is in one event");
    assert!(old <= 10, "{old} events of the past");
    assert!(skipped >= 60, "{skipped} of some 70 intervals skipped");
    assert_eq!(notices + missed, sent);
    assert!(
        notices >= 64 && missed > 0,
        "{notices} notices, {missed} missed"
    );
}

#[test]
fn an_interval_beyond_the_limits_is_refused() {
    let server = Running::start();
    for query in [
        "interval_ms=99",
        "interval_ms=5001",
        "interval_ms=-1",
        "interval_ms=x",
        "interval=200",
    ] {
        let line = format!("GET /api/v1/live?{query}");
        let (status, body) = ask(server.address, &line, &[], "");
        assert_eq!(status, 400, "{query}: {body}");
        assert!(body.contains("\"query\""), "{body}");
    }
}

#[test]
fn the_end_of_the_server_ends_it_at_once() {
    let (server, _clock) = Running::with_clock();
    let mut watching = Watching::start(&server, "");
    watching.next_of("devices");
    // At once, as its clock stands still.
    server.stop();
    while watching.next().is_some() {}
}
