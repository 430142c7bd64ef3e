//! `ihd hob` as a host that means no good finds it.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::Client;
use ihd_link::tcp::TcpTransport;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{GetStatus, Message, Stream};
use ihd_shared::wire::number::Number;

use crate::chance::Chance;
use crate::process::{Hob, PATIENCE};

fn framed<M: Message>(message: &M, number: Number) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let n = encode_numbered(message, number, 0, &mut out).unwrap();
    out[..n].to_vec()
}

/// Bytes that a hob which takes everything in would have taken.
const FLOOD: usize = 64 << 20;

#[test]
fn a_host_that_reads_nothing_and_floods_costs_no_memory() {
    let mut hob = Hob::start(&std::env::temp_dir(), &["--panel", "5"]).unwrap();
    let before = hob.process.rss();
    let mut stream = TcpStream::connect(hob.address).unwrap();
    stream
        .set_write_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    stream
        .write_all(&framed(
            &ours(ROLE_HOST, 0, 0, "test", "test"),
            Number::NONE,
        ))
        .unwrap();
    let stream_all = Stream {
        telemetry_every: 1,
        windows_every: 1,
    };
    stream
        .write_all(&framed(&stream_all, Number::FIRST))
        .unwrap();
    // One request a thousand times: each is answered.
    let status = framed(&GetStatus {}, Number::FIRST.next()).repeat(1_000);
    let mut chance = Chance::new(1);
    let garbage: Vec<u8> = (0..64 * 1024).map(|_| chance.next() as u8).collect();
    // The hob takes no more than the firmware does: before long every write blocks.
    let (mut taken, mut blocked) = (0, 0);
    while taken < FLOOD && blocked < 5 {
        for bytes in [&status, &garbage] {
            match stream.write(bytes) {
                Ok(n) => taken += n,
                Err(e) if e.kind() == ErrorKind::WouldBlock => blocked += 1,
                Err(e) => panic!("{e} after {taken} bytes"),
            }
        }
    }
    let grown = hob.process.rss().saturating_sub(before);
    // The truths of 256 half-cycles, 7 MB, are gathered meanwhile.
    assert!(grown < 32_000_000, "{grown} bytes more after {taken}");
    drop(stream);
    // And it is still a hob, once it has seen that the host is gone.
    let deadline = Instant::now() + PATIENCE;
    loop {
        let status = TcpTransport::connect(&hob.address.to_string())
            .and_then(|transport| Client::connect(Box::new(transport)))
            .and_then(|mut client| client.status());
        if status.is_ok() {
            break;
        }
        assert!(Instant::now() < deadline, "{status:?}");
        thread::sleep(Duration::from_millis(50));
    }
}
