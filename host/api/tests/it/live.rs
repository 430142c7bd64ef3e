//! What devices do now, at the pace of whoever watches: nobody is ever shown the past, and nothing is lost unsaid.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_daemon::board::now_ms;
use ihd_daemon::model::{DeviceReport, LiveDevice, Notice, What};
use serde::Deserialize as _;
use serde_json::Value;
use socket2::{Domain, Socket, Type};

use crate::backend::{NAME, Running, live};
use crate::http::{ask, connect};

/// Events of `/live`, by their names.
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

    /// The next event; none at the end.
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

    /// The next of a name.
    fn next_of(&mut self, wanted: &str) -> Value {
        loop {
            let (kind, data) = self.next().expect("not ended");
            if kind == wanted {
                return data;
            }
        }
    }
}

fn stored(seq: u32) -> Arc<Notice> {
    let what = What::WindowStored { boot: 7, seq };
    let device = NAME.into();
    Arc::new(Notice {
        at_ms: 1,
        device,
        what,
    })
}

/// Devices that are heard 100 times a second until the guard is dropped.
struct Heard {
    world: Arc<crate::backend::World>,
    ends: std::sync::mpsc::Sender<()>,
    thread: Option<std::thread::JoinHandle<()>>,
}

fn heard(server: &Running, devices: u64) -> Heard {
    let world = server.fake.world.clone();
    world.devices.store(devices, Ordering::Relaxed);
    let (ends, ended) = std::sync::mpsc::channel();
    let of = world.clone();
    let thread = std::thread::spawn(move || {
        while ended
            .recv_timeout(Duration::from_millis(10))
            .is_err_and(|e| e == std::sync::mpsc::RecvTimeoutError::Timeout)
        {
            of.half_cycles.fetch_add(1, Ordering::Relaxed);
        }
    });
    Heard {
        world,
        ends,
        thread: Some(thread),
    }
}

impl Heard {
    /// Nobody is heard from now on; how often each was.
    fn end(mut self) -> u64 {
        self.ends.send(()).unwrap();
        self.thread.take().unwrap().join().unwrap();
        self.world.half_cycles.load(Ordering::Relaxed)
    }
}

#[test]
fn a_report_that_changes_all_the_time_keeps_nothing_back() {
    let server = Running::start();
    server.fake.world.restless.store(true, Ordering::Relaxed);
    let mut watching = Watching::start(&server, "?interval_ms=100");
    let heard = heard(&server, 1);
    watching.next_of("telemetry");
    let (mut told, mut telemetry) = (0, 0);
    while telemetry < 10 {
        match watching.next().expect("not ended").0.as_str() {
            "devices" => told += 1,
            "telemetry" => telemetry += 1,
            _ => {}
        }
    }
    assert!((5..=20).contains(&told), "{told} reports in ten intervals");
    heard.end();
}

#[test]
fn devices_come_first_and_telemetry_accounts_for_each_half_cycle() {
    let server = Running::start();
    let mut watching = Watching::start(&server, "?interval_ms=100");
    let (kind, devices) = watching.next().unwrap();
    assert_eq!(kind, "devices");
    let devices = Vec::<DeviceReport>::deserialize(devices).unwrap();
    assert_eq!(devices[0].name, NAME);
    let heard = heard(&server, 2);
    let began = Instant::now();
    let (mut half_cycles, mut events) = (0, 0);
    while began.elapsed() < Duration::from_secs(3) {
        let telemetry = watching.next_of("telemetry");
        let device = &telemetry["devices"]["device-001"];
        if device.is_null() {
            continue;
        }
        let device = LiveDevice::deserialize(device).unwrap();
        half_cycles += device.half_cycles;
        events += 1;
        assert_eq!(u64::from(device.last.half_cycle), half_cycles);
        let age_ms = now_ms() - telemetry["at_ms"].as_i64().unwrap();
        assert!(age_ms < 1_000, "{age_ms} ms old");
    }
    assert!(
        (10..=32).contains(&events),
        "{events} events in 3 s at 10 a second"
    );
    let came = heard.end();
    while half_cycles < came {
        let telemetry = watching.next_of("telemetry");
        half_cycles += telemetry["devices"]["device-001"]["half_cycles"]
            .as_u64()
            .unwrap_or(0);
    }
    assert_eq!(half_cycles, came);
}

#[test]
fn where_nobody_is_heard_something_comes_each_second_all_the_same() {
    let server = Running::start();
    for query in ["", "?interval_ms=5000"] {
        let mut watching = Watching::start(&server, query);
        watching.next_of("devices");
        let began = Instant::now();
        let mut longest = Duration::ZERO;
        let (mut last, mut silent, mut devices) = (began, 0, 0);
        while began.elapsed() < Duration::from_secs(5) {
            let (kind, data) = watching.next().unwrap();
            longest = longest.max(last.elapsed());
            last = Instant::now();
            match kind.as_str() {
                "telemetry" => {
                    assert_eq!(data["devices"], serde_json::json!({}));
                    assert!(now_ms() - data["at_ms"].as_i64().unwrap() < 1_000);
                    silent += 1;
                }
                "devices" => devices += 1,
                other => panic!("{other}: {data}"),
            }
        }
        assert!(longest < Duration::from_millis(2_200), "{longest:?}");
        // Every 2 s, for this test on a busy machine.
        assert!((1..=3).contains(&devices), "{devices} times");
        assert!((2..=5).contains(&silent), "{silent} times");
    }
}

#[test]
fn what_changes_is_told_at_once_and_what_always_changes_is_not() {
    let server = Running::start();
    let heard = heard(&server, 1);
    let mut watching = Watching::start(&server, "?interval_ms=100");
    let first = watching.next_of("devices");
    assert!(first[0]["lease"].is_null());
    let began = Instant::now();
    server.fake.asked.lock().unwrap().lease = Some("Ada".into());
    let second = watching.next_of("devices");
    assert_eq!(second[0]["lease"]["holder"], "Ada");
    assert!(
        began.elapsed() < Duration::from_millis(1_500),
        "{:?}",
        began.elapsed()
    );
    // `live` is another one each time; the next comes because 2 s are over.
    watching.next_of("devices");
    assert!(
        began.elapsed() > Duration::from_millis(1_500),
        "{:?}",
        began.elapsed()
    );
    heard.end();
}

#[test]
fn every_notice_but_telemetry_comes_in_order() {
    let server = Running::start();
    let mut watching = Watching::start(&server, "");
    watching.next_of("devices");
    for seq in 0..50 {
        server.fake.notices.send(stored(seq)).unwrap();
        let telemetry = Notice {
            at_ms: 1,
            device: NAME.into(),
            what: What::Telemetry { live: live(1) },
        };
        server.fake.notices.send(Arc::new(telemetry)).unwrap();
        // The channel of this test's daemon holds 64.
        sleep(Duration::from_millis(5));
    }
    for seq in 0..50 {
        let notice = watching.next_of("notice");
        assert_eq!(notice["event"], "window-stored");
        assert_eq!(notice["seq"], seq);
    }
}

/// A reader whose own system holds next to nothing for him.
fn narrow(server: &Running) -> TcpStream {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
    socket.set_recv_buffer_size(8_192).unwrap();
    socket.connect(&server.address.into()).unwrap();
    let stream = TcpStream::from(socket);
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    stream
}

#[test]
fn who_reads_nothing_costs_nothing_and_then_sees_what_is_new() {
    let server = Running::start();
    // 30 kB an event, 300 kB a second.
    let heard = heard(&server, 64);
    let mut watching = Watching::on(narrow(&server), "?interval_ms=100");
    watching.next_of("devices");
    sleep(Duration::from_secs(2));
    let before = server.fake.world.looks.load(Ordering::Relaxed);
    sleep(Duration::from_secs(6));
    let looks = server.fake.world.looks.load(Ordering::Relaxed) - before;
    assert!(looks <= 2, "{looks} events were made that nobody took");
    // Notices meanwhile: those beyond what waits are counted.
    let mut sent = 0;
    for seq in 0..1_000 {
        server.fake.notices.send(stored(seq)).unwrap();
        sent += 1;
        if seq % 16 == 0 {
            sleep(Duration::from_millis(2));
        }
    }
    let at_ms = now_ms();
    let (mut old, mut half_cycles, mut skipped) = (0, 0, 0);
    let (mut notices, mut missed) = (0, 0);
    let came = heard.end();
    while half_cycles < came || notices + missed < sent {
        let (kind, data) = watching.next().unwrap();
        match kind.as_str() {
            "telemetry" => {
                let device = &data["devices"]["device-000"];
                half_cycles += device["half_cycles"].as_u64().unwrap_or(0);
                skipped += device["skipped"].as_u64().unwrap_or(0);
                old += u32::from(data["at_ms"].as_i64().unwrap() < at_ms - 1_000);
            }
            "notice" => notices += 1,
            "missed" => missed += data["missed"].as_u64().unwrap(),
            _ => {}
        }
    }
    assert_eq!(half_cycles, came, "each half-cycle is in one event");
    assert!(old <= 10, "{old} events of the past");
    assert!(skipped >= 60, "{skipped} of some 80 intervals skipped");
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
    let mut server = Running::start();
    let mut watching = Watching::start(&server, "");
    watching.next_of("devices");
    let began = Instant::now();
    server.stop();
    while watching.next().is_some() {}
    assert!(began.elapsed() < Duration::from_secs(3));
}
