//! Live telemetry at the pace of the client: no old data, and losses are reported.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use ihd_model::{DeviceReport, EventKind, LiveDevice};
use serde::Deserialize as _;
use serde_json::Value;
use socket2::{Domain, Socket, Type};

use crate::http::{PATIENCE, ask, connect};
use crate::rig::{Clock, NAME, OTHER, Running};

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

    /// Returns the name of the next event that is no notice.
    fn next_but_notices(&mut self) -> String {
        loop {
            let (kind, _) = self.next().expect("not ended");
            if kind != "notice" {
                return kind;
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

/// Half-cycles from one telemetry message of a hob to the next.
const HALF_CYCLES_A_MESSAGE: u64 = 10;

/// Lets `tenths` of a second pass in steps of 10 ms.
fn pass(clock: &Clock, tenths: u32) {
    for _ in 0..10 * tenths {
        clock.pass(Duration::from_millis(9));
    }
}

/// Telemetry of the first device in an event; `None` if there was none.
fn first_device(telemetry: &Value) -> Option<LiveDevice> {
    LiveDevice::deserialize(telemetry["devices"].get(NAME)?).ok()
}

/// Two messages of the hob in each interval.
#[test]
fn a_report_that_changes_all_the_time_keeps_nothing_back() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let mut watching = Watching::start(&server, "?interval_ms=200");
    watching.next_of("devices");
    for holder in 0..10 {
        server.take_lease(NAME, &format!("holder {holder}"));
        pass(&clock, 2);
        let mut both = [(); 2].map(|()| watching.next_but_notices());
        both.sort();
        assert_eq!(both, ["devices", "telemetry"]);
    }
}

#[test]
fn devices_come_first_and_telemetry_accounts_for_each_half_cycle() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let mut watching = Watching::start(&server, "?interval_ms=200");
    let (kind, reports) = watching.next().unwrap();
    assert_eq!(kind, "devices");
    let reports = Vec::<DeviceReport>::deserialize(reports).unwrap();
    assert_eq!(reports[0].name, NAME);
    let mut last = reports[0].live.as_ref().unwrap().half_cycle;
    for _ in 0..15 {
        pass(&clock, 2);
        let telemetry = watching.next_of("telemetry");
        assert!(telemetry["devices"][OTHER].is_object(), "{telemetry}");
        let device = first_device(&telemetry).unwrap();
        let new = u64::from(device.last.half_cycle - last);
        assert_eq!(device.half_cycles * HALF_CYCLES_A_MESSAGE, new);
        assert!(device.half_cycles > 0 && device.skipped == 0, "{device:?}");
        last = device.last.half_cycle;
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
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let mut watching = Watching::start(&server, "?interval_ms=200");
    let first = watching.next_of("devices");
    assert!(first[0]["lease"].is_null());
    pass(&clock, 2);
    watching.next_of("telemetry");
    server.take_lease(NAME, "Ada");
    pass(&clock, 2);
    let second = watching.next_of("devices");
    assert_eq!(second[0]["lease"]["holder"], "Ada");
    watching.next_of("telemetry");
    // `live` is another one each time; the next comes because 2 s are over.
    let mut intervals = 0;
    loop {
        pass(&clock, 2);
        intervals += 1;
        match watching.next_but_notices().as_str() {
            "telemetry" => {}
            kind => break assert_eq!(kind, "devices"),
        }
    }
    // The lease told them anew in the first or the second of its two intervals.
    assert!((9..=10).contains(&intervals), "{intervals}");
}

#[test]
fn every_notice_but_telemetry_comes_in_order() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let mut watching = Watching::start(&server, "");
    watching.next_of("devices");
    for holder in 0..50 {
        server.take_lease(NAME, &holder.to_string());
        pass(&clock, 1);
    }
    for holder in 0..50 {
        let lease = loop {
            let notice = watching.next_of("notice");
            assert_ne!(notice["event"], "telemetry");
            if notice["event"] == "lease" {
                break notice;
            }
        };
        assert_eq!(lease["holder"], holder.to_string());
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

/// Notices that fill the buffers of both ends many times over: 5 MB.
const FLOOD: u32 = 50_000;

#[test]
fn who_reads_nothing_costs_nothing_and_then_sees_what_is_new() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let mut published = server.daemon.watch();
    let mut watching = Watching::on(narrow(&server), "?interval_ms=100");
    let reports = watching.next_of("devices");
    let reports = Vec::<DeviceReport>::deserialize(reports).unwrap();
    let first = u64::from(reports[0].live.as_ref().unwrap().half_cycle);
    let mut sent = 0;
    let mut count = || {
        while let Ok(event) = published.try_recv() {
            sent += u64::from(!matches!(event.kind, EventKind::Telemetry { .. }));
        }
        sent
    };
    for k in 0..FLOOD / 2 {
        server.take_lease(NAME, "Ada");
        server.release_lease(NAME, "Ada");
        if k % 32 == 0 {
            clock.pass(Duration::ZERO);
            count();
        }
    }
    // Six seconds in which the socket takes nothing.
    let full_at = u64::from(server.report().live.unwrap().half_cycle);
    for _ in 0..60 {
        pass(&clock, 1);
        count();
    }
    let came = u64::from(server.report().live.unwrap().half_cycle);
    assert!(came - full_at > 500, "the hob went on");
    // From now on the clock advances by itself, so that the server sees that the socket is writable again.
    let is_read = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_read.load(Ordering::Relaxed) {
                pass(&clock, 1);
                sleep(Duration::from_millis(20));
            }
        });
        let (mut old, mut messages, mut last, mut skipped) = (0, 0, first, 0);
        let (mut notices, mut missed) = (0, 0);
        while last < came || notices + missed < count() {
            let (kind, data) = watching.next().unwrap();
            match kind.as_str() {
                "telemetry" => {
                    let Some(device) = first_device(&data) else {
                        continue;
                    };
                    messages += device.half_cycles;
                    skipped += device.skipped;
                    last = device.last.half_cycle.into();
                    old += u32::from((full_at..came).contains(&last));
                }
                "notice" => notices += 1,
                "missed" => missed += data["missed"].as_u64().unwrap(),
                _ => {}
            }
        }
        is_read.store(true, Ordering::Relaxed);
        assert_eq!(messages * HALF_CYCLES_A_MESSAGE, last - first, "each once");
        assert!(old <= 3, "{old} events were made that nobody took");
        assert!(skipped >= 50, "{skipped} of some 60 intervals skipped");
        assert!(
            notices >= 64 && missed > 0,
            "{notices} notices, {missed} missed"
        );
    });
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
