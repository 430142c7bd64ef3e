//! Network between a client and the server: TCP that can be partitioned, cut and healed.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Period of polling in a waiting thread.
const POLL_PERIOD: Duration = Duration::from_millis(10);

/// Most bytes forwarded by one read.
const CHUNK: usize = 64 * 1024;

struct Shared {
    to: SocketAddr,
    partitioned: AtomicBool,
    stop: AtomicBool,
    /// Bytes forwarded: from the client, to the client.
    up: AtomicU64,
    down: AtomicU64,
    /// Both ends of each connection, by its number, to be cut.
    sockets: Mutex<Vec<(u64, TcpStream)>>,
}

/// TCP proxy.
pub struct Cut {
    address: SocketAddr,
    shared: Arc<Shared>,
}

impl Cut {
    /// Listens on a port of its own and forwards to `to`, which need not listen yet.
    ///
    /// # Errors
    /// [`io::Error`] if no port is free.
    pub fn start(to: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            to,
            partitioned: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            up: AtomicU64::new(0),
            down: AtomicU64::new(0),
            sockets: Mutex::new(Vec::new()),
        });
        let own = Arc::clone(&shared);
        thread::spawn(move || accept(&listener, &own));
        Ok(Self { address, shared })
    }

    /// Returns the address for clients.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the address for clients of NATS.
    pub fn url(&self) -> String {
        format!("nats://{}", self.address)
    }

    /// Stops all traffic without closing a socket: new connections are accepted and stay silent.
    pub fn partition(&self) {
        self.shared.partitioned.store(true, Relaxed);
    }

    /// Ends [`Cut::partition`]: delayed bytes are forwarded.
    pub fn heal(&self) {
        self.shared.partitioned.store(false, Relaxed);
    }

    /// Closes every connection, as a router that restarts; new ones pass, unless partitioned.
    pub fn drop_connections(&self) {
        for (_, socket) in self.shared.sockets().drain(..) {
            let _ = socket.shutdown(Shutdown::Both);
        }
    }

    /// Returns the bytes forwarded from clients to the server, and back.
    pub fn bytes(&self) -> (u64, u64) {
        (self.shared.up.load(Relaxed), self.shared.down.load(Relaxed))
    }
}

impl Drop for Cut {
    fn drop(&mut self) {
        self.shared.stop.store(true, Relaxed);
        self.drop_connections();
    }
}

impl Shared {
    fn sockets(&self) -> std::sync::MutexGuard<'_, Vec<(u64, TcpStream)>> {
        self.sockets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits while partitioned; returns `false` at the end.
    fn passes(&self) -> bool {
        while self.partitioned.load(Relaxed) && !self.stop.load(Relaxed) {
            thread::sleep(POLL_PERIOD);
        }
        !self.stop.load(Relaxed)
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut number = 0;
    while !shared.stop.load(Relaxed) {
        match listener.accept() {
            Ok((near, _)) => {
                let own = Arc::clone(shared);
                number += 1;
                // On a thread: a connection in a partition must not block the next one.
                thread::spawn(move || {
                    // Without a far end the connection is closed, as a refused one.
                    let _ = connect(near, &own, number);
                    own.sockets().retain(|(of, _)| *of != number);
                });
            }
            Err(_) => thread::sleep(POLL_PERIOD),
        }
    }
}

fn connect(near: TcpStream, shared: &Arc<Shared>, number: u64) -> io::Result<()> {
    near.set_nonblocking(false)?;
    shared.sockets().push((number, near.try_clone()?));
    if !shared.passes() {
        return Ok(());
    }
    let far = TcpStream::connect_timeout(&shared.to, Duration::from_secs(1));
    let far = far.inspect_err(|_| drop(near.shutdown(Shutdown::Both)))?;
    for socket in [&near, &far] {
        socket.set_nodelay(true)?;
        socket.set_read_timeout(Some(POLL_PERIOD))?;
    }
    shared.sockets().push((number, far.try_clone()?));
    let (back, own) = ((far.try_clone()?, near.try_clone()?), Arc::clone(shared));
    thread::spawn(move || pass(&own, back.0, back.1, |shared| &shared.down));
    pass(shared, near, far, |shared| &shared.up);
    Ok(())
}

/// Forwards one direction of a connection; its end ends the other direction.
fn pass(shared: &Shared, mut from: TcpStream, mut to: TcpStream, count: fn(&Shared) -> &AtomicU64) {
    let mut buf = vec![0; CHUNK];
    // Checked before each read and each write: bytes read just before a partition wait for its end.
    while shared.passes() {
        match from.read(&mut buf) {
            Ok(0) => break,
            Ok(n) => {
                if !shared.passes() {
                    break;
                }
                count(shared).fetch_add(n as u64, Relaxed);
                if to.write_all(&buf[..n]).is_err() {
                    break;
                }
            }
            Err(e) if waits(&e) => {}
            Err(_) => break,
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

fn waits(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

/// Connects a client through the proxy; returns both ends.
fn through(cut: &Cut, listener: &TcpListener) -> (TcpStream, TcpStream) {
    let near = TcpStream::connect(cut.address()).unwrap();
    let (far, _) = listener.accept().unwrap();
    for socket in [&near, &far] {
        socket
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
    }
    (near, far)
}

fn read(from: &mut TcpStream, n: usize) -> Vec<u8> {
    let mut buf = vec![0; n];
    from.read_exact(&mut buf).unwrap();
    buf
}

#[test]
fn a_partition_holds_bytes_back_and_healing_brings_them_in_order() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let cut = Cut::start(listener.local_addr().unwrap()).unwrap();
    let (mut near, mut far) = through(&cut, &listener);
    near.write_all(b"before").unwrap();
    assert_eq!(read(&mut far, 6), b"before");

    cut.partition();
    near.write_all(b" during").unwrap();
    far.write_all(b"answer").unwrap();
    let quiet = Some(Duration::from_millis(300));
    for socket in [&mut near, &mut far] {
        socket.set_read_timeout(quiet).unwrap();
        let nothing = socket.read(&mut [0; 16]).unwrap_err();
        assert!(waits(&nothing), "{nothing}");
        socket
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
    }
    // A new client is accepted, and not forwarded.
    let mut late = TcpStream::connect(cut.address()).unwrap();
    late.write_all(b"late").unwrap();
    listener.set_nonblocking(true).unwrap();
    assert!(waits(&listener.accept().unwrap_err()));
    listener.set_nonblocking(false).unwrap();

    cut.heal();
    assert_eq!(read(&mut far, 7), b" during");
    assert_eq!(read(&mut near, 6), b"answer");
    let (mut far, _) = listener.accept().unwrap();
    assert_eq!(read(&mut far, 4), b"late");
    assert_eq!(cut.bytes().1, 6);
}

#[test]
fn dropped_connections_end_and_new_ones_pass() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let cut = Cut::start(listener.local_addr().unwrap()).unwrap();
    let (mut near, mut far) = through(&cut, &listener);
    near.write_all(b"x").unwrap();
    assert_eq!(read(&mut far, 1), b"x");
    cut.drop_connections();
    for socket in [&mut near, &mut far] {
        assert_eq!(socket.read(&mut [0; 8]).unwrap_or(0), 0);
    }
    let (mut near, mut far) = through(&cut, &listener);
    near.write_all(b"y").unwrap();
    assert_eq!(read(&mut far, 1), b"y");
    // A far end that is gone refuses, as the server's own port would.
    let nowhere = TcpListener::bind("127.0.0.1:0").unwrap();
    let gone = Cut::start(nowhere.local_addr().unwrap()).unwrap();
    drop(nowhere);
    let mut refused = TcpStream::connect(gone.address()).unwrap();
    assert_eq!(refused.read(&mut [0; 8]).unwrap_or(0), 0);
}
