//! Network between a client and the server: TCP that can be partitioned, cut and healed.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
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
            sockets: Mutex::new(Vec::new()),
        });
        let own = Arc::clone(&shared);
        thread::spawn(move || accept(&listener, &own));
        Ok(Self { address, shared })
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
    thread::spawn(move || pass(&own, back.0, back.1));
    pass(shared, near, far);
    Ok(())
}

/// Forwards one direction of a connection; its end ends the other direction.
fn pass(shared: &Shared, mut from: TcpStream, mut to: TcpStream) {
    let mut buf = vec![0; CHUNK];
    // Checked before each read and each write: bytes read just before a partition wait for its end.
    while shared.passes() {
        match from.read(&mut buf) {
            Ok(0) => break,
            Ok(n) => {
                if !shared.passes() {
                    break;
                }
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
