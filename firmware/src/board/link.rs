//! The link task: bytes between a port and [`Housekeeping`], and housekeeping's turn after blocks.
//!
//! Control never waits for the link: while a frame waits for its port, blocks are still polled. The
//! port that received last is the one that sends.

use embassy_futures::select::{Either, Either3, select, select3};
use embassy_futures::yield_now;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_shared::usb::PACKET;
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
    let (mut a, mut b) = ([0; PACKET], [0; PACKET]);
    let mut last_port = LastPort::First;
    let mut block_was_last = false;
    loop {
        if out.sent >= out.length {
            out.sent = 0;
            out.length = housekeeping.transmit(&mut path, &mut out.frame);
        }
        let frame = out.frame.get(out.sent..out.length).unwrap_or(&[]);
        let ports = select3(
            first.0.receive(&mut a),
            second.0.receive(&mut b),
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
            Some(Either3::First(n @ 1..)) => {
                last_port = LastPort::First;
                housekeeping.receive(&mut path, a.get(..n).unwrap_or(&[]));
            }
            Some(Either3::Second(n @ 1..)) => {
                last_port = LastPort::Second;
                housekeeping.receive(&mut path, b.get(..n).unwrap_or(&[]));
            }
            Some(Either3::Third(n)) => out.sent += n,
            // A port that is not connected.
            Some(_) => {}
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
