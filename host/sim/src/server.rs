//! The simulated hob behind a TCP port: the same bytes as in process, in real time.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use super::hob::SimHob;

/// Wall time simulated in one go: short against the link's time-outs, long against a sleep.
const SLICE: Duration = Duration::from_millis(2);

/// Lag behind real time that is given up rather than caught up with.
const LARGEST_LAG: Duration = Duration::from_millis(500);

/// Why the hob cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}{hint}", hint = hint(.source))]
    Listen {
        /// The address asked for.
        address: String,
        /// What the operating system reports.
        source: io::Error,
    },
    /// A client could not be accepted.
    #[error("cannot accept a client on {address}: {source}")]
    Accept {
        /// The address listened on.
        address: SocketAddr,
        /// What the operating system reports.
        source: io::Error,
    },
}

fn hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::AddrInUse => "; another process has the port: stop it or choose another one",
        io::ErrorKind::PermissionDenied => {
            "; ports below 1024 need privileges: choose a higher one"
        }
        io::ErrorKind::AddrNotAvailable => "; this machine has no such address",
        _ => "",
    }
}

/// What happens at the port, for whoever watches.
#[derive(Clone, Debug)]
pub enum ServerEvent {
    /// A host connected.
    Connected(SocketAddr),
    /// It went away.
    Disconnected,
    /// A second host was turned away; the link has one host at a time.
    TurnedAway(SocketAddr),
}

/// A hob and its port.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    hob: SimHob,
    client: Option<TcpStream>,
    /// Bytes that the client's socket had no room for.
    unsent: Vec<u8>,
}

impl Server {
    /// Listens on an address such as `127.0.0.1:4711`; port 0 lets the system choose.
    ///
    /// # Errors
    /// [`ServerError::Listen`] when the port is taken or the address is not ours.
    pub fn bind(address: &str, hob: SimHob) -> Result<Self, ServerError> {
        let listen = |source| ServerError::Listen {
            address: address.to_owned(),
            source,
        };
        let listener = TcpListener::bind(address).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let bound = listener.local_addr().map_err(listen)?;
        Ok(Self {
            listener,
            address: bound,
            hob,
            client: None,
            unsent: Vec::new(),
        })
    }

    /// The address that clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Runs the hob until `stop`, `speed` times as fast as real time.
    ///
    /// # Errors
    /// [`ServerError::Accept`]; a client that goes away is none.
    pub fn run(
        &mut self,
        speed: f64,
        stop: &AtomicBool,
        mut watch: impl FnMut(ServerEvent),
    ) -> Result<(), ServerError> {
        let mut wall = Instant::now();
        let mut simulated_s = self.hob.t_s();
        while !stop.load(Ordering::Relaxed) {
            simulated_s += SLICE.as_secs_f64() * speed;
            while self.hob.t_s() < simulated_s {
                self.hob.step();
            }
            if self.exchange().is_err() {
                self.client = None;
                self.unsent.clear();
                watch(ServerEvent::Disconnected);
            }
            // After the exchange, which sees that the last client is gone: the next one may be here.
            self.accept(&mut watch)?;
            wall += SLICE;
            let now = Instant::now();
            if let Some(early) = wall.checked_duration_since(now) {
                thread::sleep(early);
            } else if now - wall > LARGEST_LAG {
                wall = now;
            }
        }
        Ok(())
    }

    fn accept(&mut self, watch: &mut impl FnMut(ServerEvent)) -> Result<(), ServerError> {
        match self.listener.accept() {
            Ok((_, from)) if self.client.is_some() => watch(ServerEvent::TurnedAway(from)),
            Ok((stream, from)) => {
                let ready = stream
                    .set_nonblocking(true)
                    .and_then(|()| stream.set_nodelay(true));
                if ready.is_ok() {
                    self.client = Some(stream);
                    watch(ServerEvent::Connected(from));
                }
            }
            Err(e) if would_wait(&e) => {}
            Err(source) => {
                return Err(ServerError::Accept {
                    address: self.address,
                    source,
                });
            }
        }
        Ok(())
    }

    /// Moves bytes both ways without waiting. While nobody listens, the hob's bytes are thrown
    /// away, as a board's are.
    fn exchange(&mut self) -> io::Result<()> {
        let mut buf = [0; 16 * 1024];
        let Some(client) = &mut self.client else {
            while self.hob.receive(&mut buf) > 0 {}
            return Ok(());
        };
        loop {
            match client.read(&mut buf) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => self.hob.send(&buf[..n]),
                Err(e) if would_wait(&e) => break,
                Err(e) => return Err(e),
            }
        }
        loop {
            if self.unsent.is_empty() {
                let n = self.hob.receive(&mut buf);
                self.unsent.extend_from_slice(&buf[..n]);
            }
            if self.unsent.is_empty() {
                return Ok(());
            }
            match client.write(&self.unsent) {
                Ok(n) => drop(self.unsent.drain(..n)),
                Err(e) if would_wait(&e) => return Ok(()),
                Err(e) => return Err(e),
            }
        }
    }
}

fn would_wait(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}
