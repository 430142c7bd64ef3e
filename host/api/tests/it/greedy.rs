//! Clients that send too much, too slowly or too often lose their connection; others are served.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use ihd_api::ApiClient;
use ihd_api::access::tokens::Tokens;
use ihd_api::client::events::{Events, StreamItem};
use ihd_api::server::MAX_CONNECTIONS;
use ihd_api::tls::Certificate;
use ihd_model::Role;
use ihd_model::{Command, EventKind};

use crate::http::{PATIENCE, ask, connect};
use crate::rig::{NAME, Running};

#[test]
fn a_body_of_a_gigabyte_is_refused_at_once() {
    let server = Running::start();
    for length in ["Content-Length: 1073741824", "Transfer-Encoding: chunked"] {
        let mut stream = connect(server.address);
        let head = format!(
            "POST /api/v1/store/backup HTTP/1.1\r\nHost: localhost\r\n\
             Content-Type: application/json\r\n{length}\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).unwrap();
        // Chunks of 32 kB until the server has enough.
        let chunk = format!("8000\r\n{}\r\n", " ".repeat(0x8000));
        let mut sent = 0;
        while sent < 1 << 30 && stream.write_all(chunk.as_bytes()).is_ok() {
            sent += chunk.len();
        }
        assert!(sent < 64 << 20, "{length}: it took {sent} bytes");
    }
    let body = format!("{{\"to\":\"{}\"}}", "x".repeat(100_000));
    let json = ["Content-Type: application/json"];
    let (status, body) = ask(server.address, "POST /api/v1/store/backup", &json, &body);
    assert_eq!(status, 413, "{body}");
}

#[test]
fn a_head_that_never_ends_is_cut_off_however_it_trickles() {
    let (server, clock) = Running::with_clock();
    let (mut trickle, mut silent) = (connect(server.address), connect(server.address));
    let mut kept_alive = connect(server.address);
    let healthy = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    kept_alive.write_all(healthy).unwrap();
    one_answer(&mut kept_alive);
    trickle
        .write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
        .unwrap();
    // A head that is complete just before the limit of ten seconds is answered.
    let mut slow = connect(server.address);
    slow.write_all(&healthy[..20]).unwrap();
    for _ in 0..9 {
        trickle.write_all(b"X: y\r\n").unwrap();
        clock.pass(Duration::from_secs(1));
    }
    slow.write_all(&healthy[20..]).unwrap();
    one_answer(&mut slow);
    clock.pass(Duration::from_secs(2));
    for stream in [&mut trickle, &mut silent, &mut kept_alive] {
        let mut rest = Vec::new();
        let _ = stream.read_to_end(&mut rest).map_err(|e| {
            assert_eq!(e.kind(), std::io::ErrorKind::ConnectionReset, "{e}");
        });
    }
}

/// Reads one response of `/healthz` from a kept connection.
fn one_answer(stream: &mut TcpStream) {
    let mut answer = Vec::new();
    while !answer.ends_with(b"}") {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        answer.extend(byte);
    }
    assert!(answer.starts_with(b"HTTP/1.1 200"), "{answer:?}");
}

#[test]
fn a_head_of_a_megabyte_is_refused() {
    let server = Running::start();
    let long = format!("X: {}", "y".repeat(1 << 20));
    let (status, _) = ask(server.address, "GET /healthz", &[&long], "");
    assert_eq!(status, 431);
    let many: Vec<String> = (0..1_000).map(|k| format!("X{k}: y")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    assert_eq!(ask(server.address, "GET /healthz", &many, "").0, 431);
}

/// Unadmitted or idle connections: many times the maximum number. Ten thousand: host/ihd/tests/daemon/off_latency.rs.
const HOSTILE: usize = 1_000;

/// Number of these that the clients hold open.
const HELD: usize = 500;

fn watch(client: &ApiClient) -> Events {
    let mut events = client.events(None).unwrap();
    assert_eq!(events.next().unwrap().unwrap(), StreamItem::Heartbeat);
    events
}

/// Checks that an event stream is still connected.
fn hears(server: &Running, events: &mut Events) {
    server.take_lease(NAME, "Eve");
    let is_heard = |item: StreamItem| match item {
        StreamItem::Event(event) => match event.kind {
            EventKind::Lease { holder, .. } => holder == "Eve",
            _ => false,
        },
        _ => false,
    };
    while !is_heard(events.next().unwrap().unwrap()) {}
    server.release_lease(NAME, "Eve");
}

/// The clock is paused: no time-out frees a slot. The hostile connections send nothing, an incomplete request, or a request that needs no
/// token.
#[test]
fn a_thousand_strangers_keep_nobody_out_who_has_a_token() {
    for tls in [false, true] {
        let (mut server, clock) = Running::with_hobs_and_clock(|settings, dir| {
            settings.token_file = Some(dir.join("tokens"));
            settings.tls = tls.then(|| Certificate::Generated {
                folder: dir.join("tls"),
            });
        });
        let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
        let token = tokens.at_least(Role::Operate).map(str::to_owned);
        let ca = server.certificate.as_slice();
        let client = |name| ApiClient::new(&server.url, name, token.clone(), ca).unwrap();
        // Connected before the others.
        let known = client("Ada");
        known.command(NAME, &Command::Off).unwrap();
        let mut watched = watch(&known);
        let mut held = VecDeque::new();
        for k in 0..HOSTILE {
            let mut stream = connect(server.address);
            let request: &[u8] = match k % 4 {
                0 => b"G",
                1 => b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
                _ => b"",
            };
            // The connection may be closed already.
            let _ = stream.write_all(request);
            held.push_back(stream);
            if held.len() > HELD {
                held.pop_front();
            }
        }
        client("Bob").command(NAME, &Command::Off).unwrap();
        known.command(NAME, &Command::Off).unwrap();
        assert_eq!(server.commands().len(), 3, "TLS: {tls}");
        hears(&server, &mut watched);
        // The rest is closed by the time limit.
        clock.pass(Duration::from_secs(61));
        for stream in &mut held {
            let _ = stream.read_to_end(&mut Vec::new());
        }
    }
}

/// Without tokens any request is admitted; an idle connection can be evicted also after a request.
#[test]
fn on_plain_loopback_a_thousand_that_idle_keep_nobody_out() {
    let (server, _clock) = Running::with_hobs_and_clock(|_, _| {});
    let ada = ApiClient::new(&server.url, "Ada", None, &[]).unwrap();
    let mut watched = watch(&ada);
    let mut held = VecDeque::new();
    for k in 0..HOSTILE {
        let mut stream = connect(server.address);
        if k % 2 == 0 {
            let _ = stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n");
        }
        held.push_back(stream);
        if held.len() > HELD {
            held.pop_front();
        }
    }
    let body = r#"{"command":"off"}"#;
    let headers = ["Content-Type: application/json", "ihd-holder: Bob"];
    let line = "POST /api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/commands";
    assert_eq!(ask(server.address, line, &headers, body).0, 200);
    hears(&server, &mut watched);
    let (_, metrics) = ask(server.address, "GET /metrics", &[], "");
    let line = metrics
        .lines()
        .find_map(|l| l.strip_prefix("ihd_http_given_way_total "));
    let given_way: usize = line.unwrap().parse().unwrap();
    assert!(given_way > MAX_CONNECTIONS, "{given_way}");
}

#[test]
fn watchers_leave_places_for_others() {
    let server = Running::start();
    let mut watching: Vec<TcpStream> = (0..65)
        .map(|k| {
            let mut stream = connect(server.address);
            let path = if k % 2 == 0 { "events" } else { "live" };
            let request = format!("GET /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
            stream.write_all(request.as_bytes()).unwrap();
            stream
        })
        .collect();
    let statuses: Vec<u16> = watching
        .iter_mut()
        .map(|stream| {
            let mut head = [0; 12];
            stream.read_exact(&mut head).unwrap();
            std::str::from_utf8(&head[9..]).unwrap().parse().unwrap()
        })
        .collect();
    assert_eq!(statuses.iter().filter(|s| **s == 200).count(), 64);
    assert_eq!(statuses.iter().filter(|s| **s == 503).count(), 1);
    assert_eq!(ask(server.address, "GET /healthz", &[], "").0, 200);
    // A stream is available again once the server has detected that a client is gone.
    watching.clear();
    let deadline = Instant::now() + PATIENCE;
    loop {
        let mut stream = connect(server.address);
        stream
            .write_all(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            .unwrap();
        let mut head = [0; 12];
        stream.read_exact(&mut head).unwrap();
        if &head[9..] == b"200" {
            break;
        }
        assert!(Instant::now() < deadline, "no place is free again");
        std::thread::sleep(Duration::from_millis(10));
    }
}
