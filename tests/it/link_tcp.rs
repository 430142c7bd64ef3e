//! The link over TCP: the same bytes as in memory, and clear words when it breaks.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::thread;
use std::time::Duration;

use ihd_capture::mcap::reader::McapItem;
use ihd_capture::mcap::topics::Topic;
use ihd_capture::mcap::{McapReader, SessionRecorder};
use ihd_link::tcp::TcpTransport;
use ihd_link::{Client, DeviceEvent, DeviceSpec, LinkError, Transport};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_tests::desk_hob::{DeskHob, desk_hello};

/// A device whose time passes by commands and not by the clock: three half-cycles after each, so
/// that it sends the same bytes however fast they are carried.
struct Stepped {
    hob: DeskHob,
    mid_frame: bool,
}

impl Stepped {
    fn new() -> Self {
        Self {
            hob: DeskHob::new(desk_hello()),
            mid_frame: false,
        }
    }

    /// Takes bytes from the host; returns what the device sends.
    fn take(&mut self, bytes: &[u8]) -> Vec<u8> {
        for &byte in bytes {
            self.hob.offer(&[byte]);
            if byte == 0 && self.mid_frame {
                self.hob.run(3);
            }
            self.mid_frame = byte != 0;
        }
        self.hob.collect()
    }
}

/// The device in memory; what it has sent and nobody has received yet.
struct InMemory(Stepped, Vec<u8>);

impl Transport for InMemory {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let sent = self.0.take(bytes);
        self.1.extend(sent);
        Ok(())
    }
    fn receive(&mut self, buf: &mut [u8], _: Duration) -> Result<usize, LinkError> {
        let length = buf.len().min(self.1.len());
        buf[..length].copy_from_slice(&self.1[..length]);
        self.1.drain(..length);
        Ok(length)
    }
    fn describe(&self) -> String {
        "memory".into()
    }
}

/// Serves one host until it has nothing more to send.
fn serve(listener: TcpListener) -> thread::JoinHandle<()> {
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut device = Stepped::new();
        let mut buf = [0; 4096];
        loop {
            match stream.read(&mut buf) {
                Ok(n) if n > 0 => stream.write_all(&device.take(&buf[..n])).unwrap(),
                _ => return,
            }
        }
    })
}

fn local() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, address)
}

/// A session of commands, recorded; returns its events.
fn session(transport: Box<dyn Transport>, path: &Path) -> Vec<DeviceEvent> {
    let mut client = Client::connect(transport).unwrap();
    client.set_timeout(Duration::from_secs(60));
    client.record_to(SessionRecorder::create(path, client.hello(), client.front_end()).unwrap());
    client.set_power(1_000).unwrap();
    client.stream(1, 1).unwrap();
    for _ in 0..5 {
        client.status().unwrap();
    }
    let version_1 = RlLookup {
        version: 1,
        ..prior()
    };
    client.push_lookup(&version_1).unwrap();
    assert_eq!(client.read_lookup().unwrap(), version_1);
    assert!(client.push_lookup_bytes(b"nonsense").is_err());
    client.stream(0, 0).unwrap();
    // The last answer's half-cycles bring one more window at most; after two more commands the
    // device has nothing left to send but the answer.
    client.status().unwrap();
    client.status().unwrap();
    let mut events = Vec::new();
    while let Some(event) = client.next_event(Duration::ZERO).unwrap() {
        events.push(event);
    }
    client.finish_recording().unwrap();
    events
}

#[test]
fn the_bytes_over_tcp_are_those_in_memory() {
    let dir = tempfile::TempDir::new().unwrap();
    let [in_memory, over_tcp] = ["memory", "tcp"].map(|name| dir.path().join(name));
    let (listener, address) = local();
    let server = serve(listener);
    let spec: DeviceSpec = format!("tcp:{address}").parse().unwrap();
    let tcp = spec
        .open(|| unreachable!("not a simulated device"))
        .unwrap();
    assert_eq!(tcp.describe(), format!("tcp:{address}"));
    let there = session(tcp, &over_tcp);
    server.join().unwrap();
    let here = session(Box::new(InMemory(Stepped::new(), Vec::new())), &in_memory);
    assert!(here.iter().any(|e| matches!(e, DeviceEvent::Window(_))));
    assert_eq!(there, here);
    for topic in [Topic::FromDevice, Topic::ToDevice] {
        let (there, here) = (bytes(&over_tcp, topic), bytes(&in_memory, topic));
        assert!(here.len() > 300, "{} bytes", here.len());
        assert!(there == here, "{} and {} bytes", there.len(), here.len());
    }
    assert!(bytes(&in_memory, Topic::FromDevice).len() > 100_000);
}

/// Everything that one end of a recorded session sent.
fn bytes(path: &Path, wanted: Topic) -> Vec<u8> {
    let mut reader = McapReader::open(path).unwrap();
    let mut bytes = Vec::new();
    while let Some(item) = reader.next_item().unwrap() {
        if let McapItem::Message(m) = item
            && m.topic == wanted
        {
            bytes.extend_from_slice(m.data);
        }
    }
    bytes
}

#[test]
fn nobody_listening_is_reported_with_what_to_do() {
    let (listener, address) = local();
    drop(listener);
    let error = TcpTransport::connect(&address).err().unwrap();
    assert!(matches!(error, LinkError::Connect { .. }));
    let text = error.to_string();
    assert!(
        text.contains(&address) && text.contains("ihd hob --listen"),
        "{text}"
    );
}

#[test]
fn a_host_name_without_address_is_reported() {
    let error = TcpTransport::connect("no such host:1").err().unwrap();
    assert!(error.to_string().contains("no such host:1"), "{error}");
}

/// A peer that accepts, sends `words` and goes.
fn short_visit(words: &'static [u8]) -> String {
    let (listener, address) = local();
    thread::spawn(move || {
        let (mut stream, _): (TcpStream, _) = listener.accept().unwrap();
        stream.write_all(words).unwrap();
        // Take the hello, so that closing is no reset.
        let _ = stream.read(&mut [0; 256]);
    });
    address
}

#[test]
fn a_peer_that_leaves_is_reported() {
    for words in [&b""[..], b"SSH-2.0-OpenSSH_9.2\r\n"] {
        let transport = TcpTransport::connect(&short_visit(words)).unwrap();
        let Err(error) = Client::connect(Box::new(transport)) else {
            panic!("it must not connect");
        };
        assert!(matches!(error, LinkError::Closed { .. }), "{error}");
        assert!(error.to_string().contains("closed the link"), "{error}");
    }
}
