//! The host at the port: bytes both ways without waiting. It stays for as long as it is there, as on a board's USB.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::hello::{ROLE_DEVICE, check, ours};
use ihd_shared::wire::messages::{AnyMessage, Hello};
use socket2::{SockRef, TcpKeepalive};

use crate::hob::SimHob;

/// How long a host may take to say hello.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// After so long without anything from the host's machine the operating system asks whether it is there, so often.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(5);

/// After so long without an answer, or without acknowledgement of what was sent, the machine is gone. Shorter, and a host that is
/// stopped for a while and reads nothing would be cut off, which no board does.
#[cfg(target_os = "linux")]
pub(super) const GONE: Duration = Duration::from_secs(120);

/// Bytes from the host that may wait for the firmware; the rest waits in the operating system, and then at
/// the host.
const INBOUND: usize = 16 * 1024;

/// Why a host is let go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// It went away, or its machine is not there any more.
    Left,
    /// It did not say hello in time, or spoke another protocol.
    NoHello,
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
}

impl Guest {
    /// Takes a connection.
    pub(super) fn new(stream: TcpStream, now: Instant) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        watch_for_the_machine(&stream)?;
        Ok(Self {
            stream,
            unsent: Vec::new(),
            deframer: Deframer::new(),
            shaken: false,
            since: now,
        })
    }

    /// Its connection.
    #[cfg(test)]
    pub(super) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Moves bytes both ways without waiting.
    pub(super) fn exchange(&mut self, hob: &mut SimHob, now: Instant) -> Result<(), Ended> {
        self.take(hob).map_err(|_| Ended::Left)?;
        self.give(hob).map_err(|_| Ended::Left)?;
        if !self.shaken && now.saturating_duration_since(self.since) >= HANDSHAKE {
            return Err(Ended::NoHello);
        }
        Ok(())
    }

    fn take(&mut self, hob: &mut SimHob) -> io::Result<()> {
        let mut buf = [0; INBOUND];
        loop {
            let room = INBOUND.saturating_sub(hob.unread());
            if room == 0 {
                return Ok(());
            }
            match self.stream.read(&mut buf[..room]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(n) => {
                    self.listen(&buf[..n]);
                    hob.send(&buf[..n]);
                }
                Err(e) if would_wait(&e) => return Ok(()),
                Err(e) => return Err(e),
            }
        }
    }

    fn listen(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
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

/// A machine that lost its power, or its network, says nothing: the operating system finds it out.
fn watch_for_the_machine(stream: &TcpStream) -> io::Result<()> {
    let socket = SockRef::from(stream);
    let keep_alive = TcpKeepalive::new()
        .with_time(KEEP_ALIVE)
        .with_interval(KEEP_ALIVE_EVERY);
    socket.set_tcp_keepalive(&keep_alive)?;
    // Nothing is asked while bytes are under way.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(GONE))?;
    Ok(())
}

fn fits(theirs: &Hello) -> bool {
    check(&ours(ROLE_DEVICE, 0, 0, "", ""), theirs).is_ok()
}

pub(super) fn would_wait(e: &io::Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
