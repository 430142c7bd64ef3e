//! Simulated hob behind a TCP port: the same bytes as in process, in real time.
//!
//! It serves one host at a time, as on a cable. No buffer grows with what a host sends or leaves unread: the firmware drops and
//! counts what it cannot send, as on a board, and what it cannot receive waits at the host.

mod guest;
#[cfg(test)]
mod tests;

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread;
use std::time::{Duration, Instant};

pub use guest::DisconnectReason;
use guest::{Guest, would_wait};

use super::hob::SimHob;
use super::pace::Pace;
use super::scenario::ScenarioError;
use super::scenario::file::Scenario;
use super::scenario::script::ScenarioScript;

/// Wall time between two checks of the port: short against the link's time-outs, long against a sleep.
const SLICE: Duration = Duration::from_millis(2);

/// Number of blocks simulated between two readings of the clock.
const STEPS: usize = 8;

/// Error of serving the hob.
#[derive(Debug, thiserror::Error)]
pub enum HobServerError {
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}{hint}", hint = hint(.source))]
    Listen {
        /// Address given.
        address: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A connection could not be accepted.
    #[error("cannot accept a client on {address}: {source}")]
    Accept {
        /// The address listened on.
        address: SocketAddr,
        /// Error of the operating system.
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

/// Event at the port, for display.
#[derive(Debug)]
pub enum ServerEvent {
    /// A host connected.
    Connected(SocketAddr),
    /// A host's connection was closed.
    Disconnected {
        /// Reason.
        why: DisconnectReason,
        /// Power still requested, in watt.
        asked_w: u16,
    },
    /// A second host was rejected; the link has one host at a time.
    TurnedAway(SocketAddr),
    /// The machine is too slow: this share of the last minute, 0 to 1, was not simulated.
    Lagging(f64),
    /// A requested event is not possible.
    Impossible(ScenarioError),
}

/// Hob and its port.
pub struct HobServer {
    listener: TcpListener,
    address: SocketAddr,
    hob: SimHob,
    guest: Option<Guest>,
    scripts: Vec<ScenarioScript>,
    scenarios: Option<Receiver<Scenario>>,
}

impl HobServer {
    /// Listens on an address such as `127.0.0.1:4711`; with port 0 the system chooses one.
    ///
    /// # Errors
    /// [`HobServerError::Listen`] if the port is in use or the address is not local.
    pub fn bind(address: &str, mut hob: SimHob) -> Result<Self, HobServerError> {
        let listen = |source| HobServerError::Listen {
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
            scenarios: None,
        })
    }

    /// Address that clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The hob, for operating its panel before it runs.
    pub fn hob(&mut self) -> &mut SimHob {
        &mut self.hob
    }

    /// Sets the events of pot, mains and panel during the run.
    pub fn set_script(&mut self, script: ScenarioScript) {
        self.scripts.push(script);
    }

    /// Receives scenarios during the run; each is run once, from its arrival.
    pub fn receive_scenarios(&mut self, scenarios: Receiver<Scenario>) {
        self.scenarios = Some(scenarios);
    }

    /// Runs the hob until `stop`, `speed` times as fast as real time, or as fast as the machine can.
    ///
    /// # Errors
    /// [`HobServerError::Accept`]; a disconnecting client is no error.
    pub fn run(
        &mut self,
        speed: f64,
        stop: &AtomicBool,
        mut watch: impl FnMut(ServerEvent),
    ) -> Result<(), HobServerError> {
        let mut pace = Pace::new(speed, self.hob.t_s(), Instant::now());
        while !stop.load(Ordering::Relaxed) {
            let began = Instant::now();
            self.begin_wishes(&mut watch);
            let due_s = pace.due_s(self.hob.t_s(), began);
            let early = self.simulate(due_s, began);
            let now = Instant::now();
            self.exchange(now, &mut watch);
            // After the exchange, which notices that the last client has disconnected: the next one may be waiting.
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
        while let Some(Ok(wish)) = self.scenarios.as_ref().map(Receiver::try_recv) {
            match ScenarioScript::once(&wish, &mut self.hob) {
                Ok(script) => self.scripts.push(script),
                Err(why) => watch(ServerEvent::Impossible(why)),
            }
        }
    }

    /// Simulates up to `due_s`, or until the next check of the port; returns `true` if it got there.
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
    ) -> Result<(), HobServerError> {
        match self.listener.accept() {
            Ok((stream, from)) => self.admit(stream, from, now, watch),
            Err(e) if would_wait(&e) => {}
            // The client has disconnected already.
            Err(e) if e.kind() == io::ErrorKind::ConnectionAborted => {}
            Err(source) => {
                return Err(HobServerError::Accept {
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

    /// Discards the hob's bytes while no host is connected, as on a board.
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
