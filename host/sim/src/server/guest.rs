//! Connection to the host at the port: bytes both ways without waiting. It stays as long as it exists, as on a board's USB.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::hello::{ROLE_DEVICE, check, ours};
use ihd_shared::wire::messages::{AnyMessage, Hello};
use socket2::{SockRef, TcpKeepalive};

use crate::hob::SimHob;

/// Time limit of a host's hello.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// Idle time after which the operating system probes the host's machine, and the period of the probes.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(5);

/// Time without an answer or an acknowledgement after which the machine counts as disconnected. A shorter time would cut off a host
/// that is paused for a while, which no board does.
#[cfg(target_os = "linux")]
pub(super) const CONNECTION_TIMEOUT: Duration = Duration::from_secs(120);

/// Limit of bytes from the host that wait for the firmware; the rest waits in the operating system, and then at the host.
const INBOUND: usize = 16 * 1024;

/// Reason for closing a host's connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DisconnectReason {
    /// The host disconnected, or its machine is unreachable.
    Left,
    /// It sent no hello in time, or of another protocol.
    NoHello,
}

/// Connected host.
pub(super) struct Guest {
    stream: TcpStream,
    /// Bytes for which its socket had no room.
    unsent: Vec<u8>,
    /// Deframer of the host's frames, to detect its hello.
    deframer: Deframer,
    shaken: bool,
    since: Instant,
}

impl Guest {
    /// Accepts a connection.
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

    /// The connection.
    #[cfg(test)]
    pub(super) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Moves bytes both ways without waiting.
    pub(super) fn exchange(
        &mut self,
        hob: &mut SimHob,
        now: Instant,
    ) -> Result<(), DisconnectReason> {
        self.take(hob).map_err(|_| DisconnectReason::Left)?;
        self.give(hob).map_err(|_| DisconnectReason::Left)?;
        if !self.shaken && now.saturating_duration_since(self.since) >= HANDSHAKE {
            return Err(DisconnectReason::NoHello);
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

/// Enables keep-alive probes: only the operating system notices a machine without power or network.
fn watch_for_the_machine(stream: &TcpStream) -> io::Result<()> {
    let socket = SockRef::from(stream);
    let keep_alive = TcpKeepalive::new()
        .with_time(KEEP_ALIVE)
        .with_interval(KEEP_ALIVE_EVERY);
    socket.set_tcp_keepalive(&keep_alive)?;
    // No probes are sent while bytes are under way.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(CONNECTION_TIMEOUT))?;
    Ok(())
}

fn fits(theirs: &Hello) -> bool {
    check(&ours(ROLE_DEVICE, 0, 0, "", ""), theirs).is_ok()
}

pub(super) fn would_wait(e: &io::Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
