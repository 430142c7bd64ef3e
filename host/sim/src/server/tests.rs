//! Hosts that say no hello, and hosts that say nothing more, by a clock that the tests move: it is the `now` of each turn.

use std::io::{Read, Write};

use ihd_link::Client;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{GetStatus, Message};
use ihd_shared::wire::number::Number;

use super::*;
use crate::hob::HobConfig;
use crate::transport::SharedHob;

/// Longest wait for the operating system; it only ends a hang.
const PATIENCE: Duration = Duration::from_secs(300);

/// A port without a hob that runs, and what happened at it.
struct Port {
    server: HobServer,
    began: Instant,
    events: Vec<String>,
}

impl Port {
    fn open() -> Self {
        let hob = SimHob::new(&HobConfig::default());
        Self {
            server: HobServer::bind("127.0.0.1:0", hob).unwrap(),
            began: Instant::now(),
            events: Vec::new(),
        }
    }

    /// Looks at the port `at_s` seconds after its beginning; what happened at it.
    fn turn(&mut self, at_s: f64) -> Vec<String> {
        let now = self.began + Duration::from_secs_f64(at_s);
        let events = &mut self.events;
        let mut watch = |event| match event {
            ServerEvent::Connected(_) => events.push("connected".to_owned()),
            ServerEvent::TurnedAway(_) => events.push("turned away".to_owned()),
            ServerEvent::Disconnected { why, asked_w: 0 } => events.push(format!("{why:?}")),
            ServerEvent::Disconnected { why, asked_w } => {
                events.push(format!("{why:?} {asked_w} W"));
            }
            other => panic!("{other:?}"),
        };
        self.server.exchange(now, &mut watch);
        self.server.accept(now, &mut watch).unwrap();
        std::mem::take(&mut self.events)
    }

    /// Connects `at_s` seconds after the beginning; what happens then.
    fn connect(&mut self, at_s: f64) -> (TcpStream, Vec<String>) {
        let stream = TcpStream::connect(self.server.address()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let deadline = Instant::now() + PATIENCE;
        loop {
            let events = self.turn(at_s);
            if !events.is_empty() {
                return (stream, events);
            }
            assert!(Instant::now() < deadline, "nobody comes");
        }
    }

    /// Sends a message that the port takes in `at_s` seconds after the beginning.
    fn say(&mut self, stream: &mut TcpStream, message: &impl Message, at_s: f64) {
        let mut frame = [0; MAX_ENCODED];
        let length = encode_numbered(message, Number::FIRST, 0, &mut frame).unwrap();
        stream.write_all(&frame[..length]).unwrap();
        let unread = self.server.hob().unread();
        let deadline = Instant::now() + PATIENCE;
        while self.server.hob().unread() < unread + length {
            assert_eq!(self.turn(at_s), [""; 0]);
            assert!(Instant::now() < deadline, "it is not taken in");
        }
    }
}

/// The other end is told nothing more.
fn is_let_go(mut stream: TcpStream) {
    assert_eq!(stream.read(&mut [0; 64]).unwrap_or(0), 0);
}

#[test]
fn a_host_that_says_no_hello_is_let_go_after_five_seconds() {
    let mut port = Port::open();
    let (silent, events) = port.connect(0.0);
    assert_eq!(events, ["connected"]);
    assert_eq!(port.turn(4.99), [""; 0]);
    assert_eq!(port.turn(5.0), ["NoHello"]);
    is_let_go(silent);
    // Frames that are no hello do not help.
    let (mut chatty, events) = port.connect(10.0);
    assert_eq!(events, ["connected"]);
    for second in 10..15 {
        port.say(&mut chatty, &GetStatus {}, second.into());
    }
    assert_eq!(port.turn(14.99), [""; 0]);
    assert_eq!(port.turn(15.0), ["NoHello"]);
}

/// A host reads an idle hob's telemetry and has nothing to ask: a board on USB lets it, for as long as it is there.
#[test]
fn three_idle_hosts_stay_for_a_day_and_nobody_gets_their_place() {
    let hello = ours(ROLE_HOST, 0, 0, "test", "test");
    let mut ports = [(); 3].map(|()| Port::open());
    let mut hosts = ports.each_mut().map(|port| {
        let (mut host, events) = port.connect(0.0);
        assert_eq!(events, ["connected"]);
        port.say(&mut host, &hello, 1.0);
        host
    });
    for minute in 1..=24 * 60 {
        for port in &mut ports {
            let at_s = 60.0 * f64::from(minute);
            assert_eq!(port.turn(at_s), [""; 0], "minute {minute}");
            if minute % 60 == 0 {
                let (other, events) = port.connect(at_s + 1.0);
                assert_eq!(events, ["turned away"], "minute {minute}");
                is_let_go(other);
            }
        }
    }
    // What they say then is still taken in, and once one has left the next one may come.
    for (port, host) in ports.iter_mut().zip(hosts.each_mut()) {
        port.say(host, &GetStatus {}, 86_402.0);
    }
    drop(hosts);
    let (_next, mut events) = ports[0].connect(86_403.0);
    while events.len() < 2 {
        events.extend(ports[0].turn(86_403.0));
    }
    assert_eq!(events, ["Left", "connected"]);
}

/// A machine that is gone says nothing either: the operating system has to ask for it.
#[cfg(target_os = "linux")]
#[test]
fn a_machine_that_is_gone_is_found_out_by_the_operating_system() {
    let mut port = Port::open();
    let (_host, _) = port.connect(0.0);
    let guest = port.server.guest.as_ref().unwrap();
    let socket = socket2::SockRef::from(guest.stream());
    assert!(socket.keepalive().unwrap());
    assert_eq!(
        socket.tcp_user_timeout().unwrap(),
        Some(guest::CONNECTION_TIMEOUT)
    );
}

#[test]
fn what_a_host_leaves_unread_is_dropped_and_counted() {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = Client::connect(Box::new(hob.clone())).unwrap();
    client.stream(1, 1).unwrap();
    client.set_power(1_000).unwrap();
    assert_eq!(client.status().unwrap().telemetry_dropped, 0);
    hob.lock().bound_link();
    // Until its buffer is full, and longer.
    let until_s = hob.lock().t_s() + 1.0;
    while hob.lock().t_s() < until_s {
        hob.lock().step();
    }
    assert!(client.status().unwrap().telemetry_dropped > 0);
}
