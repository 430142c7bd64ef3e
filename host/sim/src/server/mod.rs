//! The simulated hob behind a TCP port: the same bytes as in process, in real time.
//!
//! One host at a time, as on a cable. Nothing grows with what a host sends or leaves unread: what the firmware
//! cannot send it drops and counts itself, as on a board, and what it cannot take in waits at the host.

mod guest;
#[cfg(test)]
mod tests;

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread;
use std::time::{Duration, Instant};

pub use guest::Ended;
use guest::{Guest, would_wait};

use super::hob::SimHob;
use super::pace::Pace;
use super::scenario::ScenarioError;
use super::scenario::file::Scenario;
use super::scenario::script::Script;

/// Wall time between two looks at the port: short against the link's time-outs, long against a sleep.
const SLICE: Duration = Duration::from_millis(2);

/// Blocks simulated between two looks at the clock.
const STEPS: usize = 8;

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
#[derive(Debug)]
pub enum ServerEvent {
    /// A host connected.
    Connected(SocketAddr),
    /// It was let go.
    Disconnected {
        /// Why.
        why: Ended,
        /// Power that it has left asked for, in watt.
        asked_w: u16,
    },
    /// A second host was turned away; the link has one host at a time.
    TurnedAway(SocketAddr),
    /// The machine is too slow: of the last minute this share, 0 to 1, was not simulated.
    Lagging(f64),
    /// What somebody wanted to happen cannot.
    Impossible(ScenarioError),
}

/// A hob and its port.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    hob: SimHob,
    guest: Option<Guest>,
    scripts: Vec<Script>,
    wishes: Option<Receiver<Scenario>>,
}

impl Server {
    /// Listens on an address such as `127.0.0.1:4711`; port 0 lets the system choose.
    ///
    /// # Errors
    /// [`ServerError::Listen`] when the port is taken or the address is not ours.
    pub fn bind(address: &str, mut hob: SimHob) -> Result<Self, ServerError> {
        let listen = |source| ServerError::Listen {
            address: address.to_owned(),
            source,
        };
        let listener = TcpListener::bind(address).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let bound = listener.local_addr().map_err(listen)?;
        hob.bound_link();
        Ok(Self {
            listener,
            address: bound,
            hob,
            guest: None,
            scripts: Vec::new(),
            wishes: None,
        })
    }

    /// The address that clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The hob, to touch its panel before it runs.
    pub fn hob(&mut self) -> &mut SimHob {
        &mut self.hob
    }

    /// What happens to pot, mains and panel meanwhile.
    pub fn play(&mut self, script: Script) {
        self.scripts.push(script);
    }

    /// What somebody else wants to happen while it runs: each once, from when it comes.
    pub fn listen_to(&mut self, wishes: Receiver<Scenario>) {
        self.wishes = Some(wishes);
    }

    /// Runs the hob until `stop`, `speed` times as fast as real time, or as fast as the machine can.
    ///
    /// # Errors
    /// [`ServerError::Accept`]; a client that goes away is none.
    pub fn run(
        &mut self,
        speed: f64,
        stop: &AtomicBool,
        mut watch: impl FnMut(ServerEvent),
    ) -> Result<(), ServerError> {
        let mut pace = Pace::new(speed, self.hob.t_s(), Instant::now());
        while !stop.load(Ordering::Relaxed) {
            let began = Instant::now();
            self.begin_wishes(&mut watch);
            let due_s = pace.due_s(self.hob.t_s(), began);
            let early = self.simulate(due_s, began);
            let now = Instant::now();
            self.exchange(now, &mut watch);
            // After the exchange, which sees that the last client is gone: the next one may be here.
            self.accept(now, &mut watch)?;
            if let Some(share) = pace.lag(now) {
                watch(ServerEvent::Lagging(share));
            }
            if early {
                thread::sleep(SLICE.saturating_sub(began.elapsed()));
            }
        }
        Ok(())
    }

    fn begin_wishes(&mut self, watch: &mut impl FnMut(ServerEvent)) {
        self.scripts.retain(|script| !script.is_over());
        while let Some(Ok(wish)) = self.wishes.as_ref().map(Receiver::try_recv) {
            match Script::once(&wish, &mut self.hob) {
                Ok(script) => self.scripts.push(script),
                Err(why) => watch(ServerEvent::Impossible(why)),
            }
        }
    }

    /// Simulates up to `due_s`, or until it is time to look at the port again; whether it got there.
    fn simulate(&mut self, due_s: f64, began: Instant) -> bool {
        while self.hob.t_s() < due_s {
            if began.elapsed() >= SLICE {
                return false;
            }
            for _ in 0..STEPS {
                for script in &mut self.scripts {
                    script.turn(&mut self.hob);
                }
                self.hob.step();
            }
        }
        true
    }

    fn accept(
        &mut self,
        now: Instant,
        watch: &mut impl FnMut(ServerEvent),
    ) -> Result<(), ServerError> {
        match self.listener.accept() {
            Ok((stream, from)) => self.admit(stream, from, now, watch),
            Err(e) if would_wait(&e) => {}
            // It came and went.
            Err(e) if e.kind() == io::ErrorKind::ConnectionAborted => {}
            Err(source) => {
                return Err(ServerError::Accept {
                    address: self.address,
                    source,
                });
            }
        }
        Ok(())
    }

    fn admit(
        &mut self,
        stream: TcpStream,
        from: SocketAddr,
        now: Instant,
        watch: &mut impl FnMut(ServerEvent),
    ) {
        if self.guest.is_some() {
            return watch(ServerEvent::TurnedAway(from));
        }
        self.guest = Guest::new(stream, now).ok();
        self.discard();
        if self.guest.is_some() {
            watch(ServerEvent::Connected(from));
        }
    }

    /// While nobody listens, the hob's bytes are thrown away, as a board's are.
    fn discard(&mut self) {
        let mut buf = [0; 16 * 1024];
        while self.hob.receive(&mut buf) > 0 {}
    }

    fn exchange(&mut self, now: Instant, watch: &mut impl FnMut(ServerEvent)) {
        let Some(guest) = &mut self.guest else {
            return self.discard();
        };
        if let Err(why) = guest.exchange(&mut self.hob, now) {
            self.guest = None;
            let control = self.hob.housekeeping().control();
            let asked_w = match control.request().is_of_host() {
                true => control.asked_w(),
                false => 0,
            };
            watch(ServerEvent::Disconnected { why, asked_w });
        }
    }
}
