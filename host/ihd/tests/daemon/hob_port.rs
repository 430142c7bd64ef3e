//! `ihd hob` as a host that means no good finds it.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::Client;
use ihd_link::tcp::TcpTransport;
use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{GetStatus, Message, Stream};

use crate::chance::Chance;
use crate::process::Hob;

fn framed<M: Message>(message: &M) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let n = encode(message, 0, &mut out).unwrap();
    out[..n].to_vec()
}

fn hob(options: &[&str]) -> Hob {
    Hob::start(&std::env::temp_dir(), options).unwrap()
}

fn connect(hob: &Hob) -> TcpStream {
    let stream = TcpStream::connect(hob.address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(40)))
        .unwrap();
    stream
}

/// Time until the hob lets go, with whatever it says on the way.
fn until_let_go(stream: &mut TcpStream) -> Duration {
    let began = Instant::now();
    loop {
        match stream.read(&mut [0; 4096]) {
            Ok(0) => return began.elapsed(),
            Ok(_) => {}
            Err(e) if e.kind() == ErrorKind::ConnectionReset => return began.elapsed(),
            Err(e) => panic!("still there after {:?}: {e}", began.elapsed()),
        }
    }
}

#[test]
fn a_host_that_says_no_hello_is_let_go_after_five_seconds() {
    let hob = hob(&["--speed", "0.1"]);
    let mut silent = connect(&hob);
    let took = until_let_go(&mut silent);
    assert!((4.5..9.0).contains(&took.as_secs_f64()), "{took:?}");
    // Frames that are no hello do not help.
    let mut chatty = connect(&hob);
    let mut own = chatty.try_clone().unwrap();
    thread::spawn(move || {
        while own.write_all(&framed(&GetStatus {})).is_ok() {
            thread::sleep(Duration::from_millis(100));
        }
    });
    let took = until_let_go(&mut chatty);
    assert!((4.5..9.0).contains(&took.as_secs_f64()), "{took:?}");
}

#[test]
#[ignore = "three quarters of a minute: cargo xtask daemon runs it"]
fn a_silent_host_gives_way_after_ten_seconds_and_goes_after_thirty() {
    let hob = hob(&["--speed", "0.1"]);
    let hello = framed(&ours(ROLE_HOST, 0, 0, "test", "test"));
    let began = Instant::now();
    let mut first = connect(&hob);
    first.write_all(&hello).unwrap();
    // A second one is turned away, without a word.
    thread::sleep(Duration::from_secs(1));
    let mut second = connect(&hob);
    let mut said = Vec::new();
    assert_eq!(second.read_to_end(&mut said).unwrap_or(0), 0);
    // Later it gets the place.
    thread::sleep(Duration::from_secs(11).saturating_sub(began.elapsed()));
    let mut third = connect(&hob);
    third.write_all(&hello).unwrap();
    assert!(until_let_go(&mut first) < Duration::from_secs(5));
    let took = until_let_go(&mut third);
    assert!((29.0..36.0).contains(&took.as_secs_f64()), "{took:?}");
}

#[test]
fn a_host_that_reads_nothing_and_floods_costs_no_memory() {
    let mut hob = hob(&["--panel", "5"]);
    let before = hob.process.rss();
    let mut stream = connect(&hob);
    stream
        .set_write_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    stream
        .write_all(&framed(&ours(ROLE_HOST, 0, 0, "test", "test")))
        .unwrap();
    let stream_all = Stream {
        telemetry_every: 1,
        windows_every: 1,
    };
    stream.write_all(&framed(&stream_all)).unwrap();
    let status = framed(&GetStatus {}).repeat(1_000);
    let mut chance = Chance::new(1);
    let garbage: Vec<u8> = (0..64 * 1024).map(|_| chance.next() as u8).collect();
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(10) {
        // The hob takes no more than the firmware does: both block in time.
        let _ = stream.write(&status);
        let _ = stream.write(&garbage);
    }
    let grown = hob.process.rss().saturating_sub(before);
    // The truths of 256 half-cycles, 7 MB, are gathered meanwhile.
    assert!(grown < 32_000_000, "{grown} bytes more after 10 s");
    drop(stream);
    // And it is still a hob.
    thread::sleep(Duration::from_millis(500));
    let transport = TcpTransport::connect(&hob.address.to_string()).unwrap();
    let mut client = Client::connect(Box::new(transport)).unwrap();
    let status = client.status().unwrap();
    assert!(
        status.telemetry_dropped > 0,
        "what was left unread is counted: {status:?}"
    );
}
