//! The link task: bytes between a port and [`Housekeeping`], and housekeeping's turn after blocks.
//!
//! Control never waits for the link: while a frame waits for its port, blocks are still polled. The
//! port that received last is the one that sends.

use embassy_futures::select::{Either, Either3, select, select3};
use embassy_futures::yield_now;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_shared::wire::frame::MAX_ENCODED;

use super::crash;
use super::sampling::{BLOCK_DONE, ThreadSide};

/// The receiving half of a port. The future may be dropped before it is ready without losing bytes.
pub trait Receive {
    /// Waits for bytes; returns how many.
    async fn receive(&mut self, buf: &mut [u8]) -> usize;
}

/// The sending half of a port. The future may be dropped before it is ready without losing bytes.
pub trait Send {
    /// Waits for room and sends some of `bytes`; returns how many.
    async fn send(&mut self, bytes: &[u8]) -> usize;
}

/// A port that the board does not have.
pub struct NoPort;

impl Receive for NoPort {
    async fn receive(&mut self, _: &mut [u8]) -> usize {
        core::future::pending().await
    }
}

impl Send for NoPort {
    async fn send(&mut self, _: &[u8]) -> usize {
        core::future::pending().await
    }
}

/// A frame on its way out.
struct Outgoing {
    frame: [u8; MAX_ENCODED],
    sent: usize,
    length: usize,
}

/// Bytes that came in and that housekeeping has not taken yet.
struct Inbox<const N: usize> {
    bytes: [u8; N],
    taken: usize,
    length: usize,
}

impl<const N: usize> Inbox<N> {
    const EMPTY: Self = Self {
        bytes: [0; N],
        taken: 0,
        length: 0,
    };

    fn rest(&self) -> &[u8] {
        self.bytes.get(self.taken..self.length).unwrap_or(&[])
    }

    /// Room to receive into; none while bytes are left.
    fn room(&mut self) -> Option<&mut [u8]> {
        self.rest().is_empty().then_some(&mut self.bytes)
    }

    fn filled(&mut self, length: usize) {
        (self.taken, self.length) = (0, length);
    }
}

/// The port in use.
#[derive(Clone, Copy, PartialEq)]
enum LastPort {
    First,
    Second,
}

/// Runs the link for ever. `tick` is called after each block, once housekeeping has seen it.
pub async fn run(
    mut first: (impl Receive, impl Send),
    mut second: (impl Receive, impl Send),
    housekeeping: &mut Housekeeping,
    mut path: ThreadSide,
    mut tick: impl FnMut(&mut Housekeeping, &mut ThreadSide),
) -> ! {
    let mut out = Outgoing {
        frame: [0; MAX_ENCODED],
        sent: 0,
        length: 0,
    };
    // 64 bytes are a USB packet.
    let (mut a, mut b) = (Inbox::<64>::EMPTY, Inbox::<64>::EMPTY);
    let mut last_port = LastPort::First;
    let mut block_was_last = false;
    loop {
        for (inbox, port) in [(&mut a, LastPort::First), (&mut b, LastPort::Second)] {
            if !inbox.rest().is_empty() {
                last_port = port;
                inbox.taken += housekeeping.receive(&mut path, inbox.rest());
            }
        }
        if out.sent >= out.length {
            out.sent = 0;
            out.length = housekeeping.transmit(&mut path, &mut out.frame);
        }
        let frame = out.frame.get(out.sent..out.length).unwrap_or(&[]);
        let ports = select3(
            receive(&mut first.0, a.room()),
            receive(&mut second.0, b.room()),
            send(&mut first.1, &mut second.1, last_port, frame),
        );
        // In turn: whatever the host sends, control gets its turn, and however fast blocks come, the
        // ports get theirs.
        let event = if block_was_last {
            match select(ports, BLOCK_DONE.wait()).await {
                Either::First(port) => Some(port),
                Either::Second(()) => None,
            }
        } else {
            match select(BLOCK_DONE.wait(), ports).await {
                Either::First(()) => None,
                Either::Second(port) => Some(port),
            }
        };
        block_was_last = event.is_none();
        match event {
            Some(Either3::First(n)) => a.filled(n),
            Some(Either3::Second(n)) => b.filled(n),
            Some(Either3::Third(n)) => out.sent += n,
            None => {
                housekeeping.poll(&mut path);
                // Before anything that may lead to a reset.
                let fault = path.with(|path| path.fault());
                crash::note_state(fault.number(), housekeeping.control().retained());
                tick(housekeeping, &mut path);
                // Where a turn takes longer than a block, nothing above ever waits: the executor's other tasks would get no
                // turn at all.
                yield_now().await;
            }
        }
    }
}

async fn receive(port: &mut impl Receive, room: Option<&mut [u8]>) -> usize {
    match room {
        Some(buf) => port.receive(buf).await,
        None => core::future::pending().await,
    }
}

async fn send(
    first: &mut impl Send,
    second: &mut impl Send,
    last_port: LastPort,
    frame: &[u8],
) -> usize {
    match (frame, last_port) {
        ([], _) => core::future::pending().await,
        (_, LastPort::First) => first.send(frame).await,
        (_, LastPort::Second) => second.send(frame).await,
    }
}
