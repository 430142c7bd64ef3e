//! Those who send too much, too slowly, or too often: they lose, and the others are served.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use ihd_api::model::Problem;
use ihd_api::server::MAX_CONNECTIONS;

use crate::backend::Running;
use crate::http::{PATIENCE, answer, ask, connect};

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
    // A head that came whole is answered after nearly all of the ten seconds.
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

/// Reads the answer of `/healthz`, whose connection stays.
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

#[test]
fn a_thousand_connections_leave_the_daemon_alive() {
    // A clock that stands still leaves those that hold a place their ten seconds for a head.
    let (server, _clock) = Running::with_clock();
    let mut held: Vec<TcpStream> = Vec::new();
    for _ in 0..1_000 {
        match TcpStream::connect_timeout(&server.address, PATIENCE) {
            Ok(stream) => held.push(stream),
            Err(e) => panic!("{e} after {} connections", held.len()),
        }
    }
    // Those above the limit are told, the others wait for their heads.
    let mut told = 0;
    for stream in &mut held[MAX_CONNECTIONS..] {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (status, body) = answer(stream);
        assert_eq!(status, 503, "{body}");
        let problem: Problem = serde_json::from_str(&body).unwrap();
        assert_eq!(problem.error, "connections");
        told += 1;
    }
    assert_eq!(told, 1_000 - MAX_CONNECTIONS);
    drop(held);
    let deadline = Instant::now() + PATIENCE;
    loop {
        let (status, metrics) = ask(server.address, "GET /metrics", &[], "");
        if status == 200 {
            let line = metrics
                .lines()
                .find_map(|l| l.strip_prefix("ihd_http_turned_away_total "));
            // Those of this loop that came too early are among them.
            assert!(line.unwrap().parse::<usize>().unwrap() >= told, "{metrics}");
            break;
        }
        assert!(Instant::now() < deadline, "still {status}");
        std::thread::sleep(Duration::from_millis(10));
    }
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
    // A place is free again when the server has seen that its watcher went.
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
