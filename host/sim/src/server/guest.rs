//! The host at the port: bytes both ways without waiting, and how long it may be silent.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::hello::{ROLE_DEVICE, check, ours};
use ihd_shared::wire::messages::{AnyMessage, Hello};

use crate::hob::SimHob;

/// How long a host may take to say hello.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// After so long without a frame the host is gone.
const IDLE: Duration = Duration::from_secs(30);

/// After so long without a frame another host may have its place: by then the firmware has switched off what
/// it had asked for.
const REPLACEABLE: Duration = Duration::from_secs(10);

/// Bytes from the host that may wait for the firmware; the rest waits in the operating system, and then at
/// the host.
const INBOUND: usize = 16 * 1024;

/// Why a host is let go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// It went away.
    Left,
    /// It did not say hello in time, or spoke another protocol.
    NoHello,
    /// It sent no frame for too long.
    Idle,
    /// It was silent, and another one came.
    Replaced,
}

/// A connected host.
pub(super) struct Guest {
    stream: TcpStream,
    /// Bytes that its socket had no room for.
    unsent: Vec<u8>,
    /// Listens in.
    deframer: Deframer,
    shaken: bool,
    since: Instant,
    heard: Instant,
}

impl Guest {
    /// Takes a connection.
    pub(super) fn new(stream: TcpStream, now: Instant) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        Ok(Self {
            stream,
            unsent: Vec::new(),
            deframer: Deframer::new(),
            shaken: false,
            since: now,
            heard: now,
        })
    }

    /// Whether another host may have its place.
    pub(super) fn is_replaceable(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.heard) >= REPLACEABLE
    }

    /// Moves bytes both ways without waiting.
    pub(super) fn exchange(&mut self, hob: &mut SimHob, now: Instant) -> Result<(), Ended> {
        self.take(hob, now).map_err(|_| Ended::Left)?;
        self.give(hob).map_err(|_| Ended::Left)?;
        if !self.shaken && now.saturating_duration_since(self.since) >= HANDSHAKE {
            return Err(Ended::NoHello);
        }
        if now.saturating_duration_since(self.heard) >= IDLE {
            return Err(Ended::Idle);
        }
        Ok(())
    }

    fn take(&mut self, hob: &mut SimHob, now: Instant) -> io::Result<()> {
        let mut buf = [0; INBOUND];
        loop {
            let room = INBOUND.saturating_sub(hob.unread());
            if room == 0 {
                return Ok(());
            }
            match self.stream.read(&mut buf[..room]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    self.listen(&buf[..n], now);
                    hob.send(&buf[..n]);
                }
                Err(e) if would_wait(&e) => return Ok(()),
                Err(e) => return Err(e),
            }
        }
    }

    fn listen(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            self.heard = now;
            if let Ok(AnyMessage::Hello(theirs)) = AnyMessage::decode(frame.id, frame.payload) {
                self.shaken = fits(&theirs);
            }
        }
    }

    fn give(&mut self, hob: &mut SimHob) -> io::Result<()> {
        let mut buf = [0; 16 * 1024];
        loop {
            if self.unsent.is_empty() {
                let n = hob.receive(&mut buf);
                self.unsent.extend_from_slice(&buf[..n]);
            }
            if self.unsent.is_empty() {
                return Ok(());
            }
            match self.stream.write(&self.unsent) {
                Ok(n) => drop(self.unsent.drain(..n)),
                Err(e) if would_wait(&e) => return Ok(()),
                Err(e) => return Err(e),
            }
        }
    }
}

fn fits(theirs: &Hello) -> bool {
    check(&ours(ROLE_DEVICE, 0, 0, "", ""), theirs).is_ok()
}

pub(super) fn would_wait(e: &io::Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
