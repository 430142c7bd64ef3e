//! The transmit queue, the link's outgoing side: order in which responses, events and data leave, and counts of what is dropped.
//!
//! | order | what | where it waits |
//! |---|---|---|
//! | 1 | responses | 8 in a queue, then dropped: a host repeats what had no response |
//! | 1 | faults | in the same queue, once there is room |
//! | 1 | requested pieces of windows | in the same queue, dropped if they would leave room for less than 2 responses |
//! | 2 | telemetry | 4 in a queue, then dropped |
//! | 3 | log | [`crate::link::log_ring`] |
//! | 4 | windows | the recorder's slot |
//! | 5 | bytes of a test of the link | made as they leave |
//!
//! Nothing waits for the link. The log leaves before windows: its frames are rare and short, and on a slow link a stream of windows would
//! never let it pass; a flood of it is dropped where it is kept. Telemetry and windows take their sequence number before they
//! take a place, so that a drop shows as a gap at the host. A window that was sent stays for a while, for a host that misses
//! pieces of it.

use heapless::Deque;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::messages::{Hello, LookupBlob, Piece, Raw, ResendWindow, Telemetry};
use ihd_shared::wire::number::Number;

use crate::link::frame_writer::FrameWriter;
use crate::link::identity::DeviceIdentity;
use crate::link::link_test_sender::LinkTestSender;
use crate::link::log_ring::LinkLog;
use crate::link::log_sender::LogSender;
use crate::link::replay::ReplayedEstimates;
use crate::link::response::{Response, front_end};
use crate::link::window_sender::WindowSender;
use crate::sampling::path::SamplingLock;

/// Responses that may wait for the link.
const RESPONSES: usize = 8;

/// Places in the queue of responses that requested pieces of windows leave to others.
const NOT_FOR_PIECES: usize = 2;

/// Telemetry messages that may wait.
const TELEMETRY: usize = 4;

/// Queues and counters of the outgoing side.
pub struct TransmitQueue {
    hello: Hello,
    identity: DeviceIdentity,
    frames: FrameWriter,
    responses: Deque<(Number, Response), RESPONSES>,
    telemetry: Deque<Telemetry, TELEMETRY>,
    telemetry_due: u32,
    telemetry_dropped: u32,
    log: LogSender,
    windows: WindowSender,
    link_test: LinkTestSender,
}

impl TransmitQueue {
    /// Nothing queued.
    pub fn new(hello: Hello) -> Self {
        Self {
            hello,
            identity: DeviceIdentity::default(),
            frames: FrameWriter::default(),
            responses: Deque::new(),
            telemetry: Deque::new(),
            telemetry_due: 0,
            telemetry_dropped: 0,
            log: LogSender::default(),
            windows: WindowSender::default(),
            link_test: LinkTestSender::default(),
        }
    }

    /// Our hello.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Sets the identity of the device.
    pub fn set_identity(&mut self, identity: DeviceIdentity) {
        self.identity = identity;
    }

    /// Sets the place where the log is kept until it is sent.
    pub fn set_log(&mut self, log: &'static LinkLog) {
        self.log.set_log(log);
    }

    /// Sends the log from now on, or no more; returns `false` if there is none.
    pub fn stream_log(&mut self, on: bool) -> bool {
        self.log.stream(on)
    }

    /// Sends so many frames of a test of the link, in place of those that were left of another.
    pub fn send_link_data(&mut self, frames: u16, bytes: u16) {
        self.link_test = LinkTestSender::new(frames, bytes);
    }

    /// Sets or clears one of the hello's capabilities.
    pub fn set_capability(&mut self, bit: u32, on: bool) {
        if on {
            self.hello.capabilities |= bit;
        } else {
            self.hello.capabilities &= !bit;
        }
    }

    /// Returns `true` if another response would find no room.
    pub fn is_full(&self) -> bool {
        self.responses.is_full()
    }

    /// Queues the response to the request of this number; drops it if the queue is full.
    pub fn respond(&mut self, number: Number, response: Response) {
        let _ = self.responses.push_back((number, response));
    }

    /// Queues a message that answers no request.
    pub fn announce(&mut self, event: Response) {
        self.respond(Number::NONE, event);
    }

    /// Queues telemetry that is due: takes a number, then a place if there is one. `fill` gets number and drop count.
    pub fn telemetry(&mut self, fill: impl FnOnce(u32, u32) -> Telemetry) {
        let seq = self.telemetry_due;
        self.telemetry_due = seq.wrapping_add(1);
        if self.telemetry.is_full() {
            self.telemetry_dropped = self.telemetry_dropped.wrapping_add(1);
            return;
        }
        let _ = self.telemetry.push_back(fill(seq, self.telemetry_dropped));
    }

    /// Telemetry messages that found their queue full.
    pub fn telemetry_dropped(&self) -> u32 {
        self.telemetry_dropped
    }

    /// Forgets everything queued for a host that is gone.
    pub fn restart(&mut self, lock: &mut impl SamplingLock) {
        self.responses.clear();
        self.telemetry.clear();
        self.log.stream(false);
        self.link_test = LinkTestSender::default();
        self.windows.forget(lock);
    }

    /// Takes a host's request for a piece of a window, or its release of it.
    pub fn resend(&mut self, lock: &mut impl SamplingLock, m: ResendWindow) {
        if m.piece != Piece::Nothing {
            self.windows.keep();
            if self.responses.len() + NOT_FOR_PIECES < RESPONSES {
                self.announce(Response::Piece(m));
            }
        } else {
            self.windows.release(m.seq, lock);
        }
    }

    /// Counts a half-cycle, for windows that were sent.
    pub fn on_half_cycle(&mut self, lock: &mut impl SamplingLock) {
        self.windows.on_half_cycle(lock);
    }

    /// Writes the next frame, if there is one; returns its length, 0 for none.
    pub fn transmit(
        &mut self,
        lock: &mut impl SamplingLock,
        lookup: &RlLookup,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        if let Some((number, response)) = self.responses.pop_front() {
            return self.write_response(number, response, lock, lookup, out);
        }
        if let Some(telemetry) = self.telemetry.pop_front() {
            return self.frames.write(&telemetry, out);
        }
        if let Some(length) = self.log.write(&mut self.frames, out) {
            return length;
        }
        match self.windows.write(lock, &mut self.frames, out) {
            0 => self.link_test.write(&mut self.frames, out),
            length => length,
        }
    }

    fn write_response(
        &mut self,
        number: Number,
        response: Response,
        lock: &mut impl SamplingLock,
        lookup: &RlLookup,
        out: &mut [u8; MAX_ENCODED],
    ) -> usize {
        let frames = &mut self.frames;
        match response {
            Response::Hello => frames.write(&self.hello, out),
            Response::FrontEnd => frames.write_numbered(&front_end(), number, out),
            Response::Reply(m) => frames.write_numbered(&m, number, out),
            Response::Status(m) => frames.write_numbered(&m, number, out),
            Response::Utilisation(m) => frames.write_numbered(&m, number, out),
            Response::Lookup => {
                let blob = lookup.to_bytes();
                frames.write_numbered(&LookupBlob { blob: Raw(&blob) }, number, out)
            }
            Response::Fault(m) => frames.write(&m, out),
            Response::ReplayMode(m) => frames.write_numbered(&m, number, out),
            Response::ReplayEstimates(estimates) => {
                let mut raw = [0; ReplayedEstimates::BYTES];
                frames.write_numbered(&estimates.message(&mut raw), number, out)
            }
            Response::Piece(m) => self.windows.write_piece(&m, lock, frames, out),
            Response::Board => frames.write_numbered(&self.identity.message(), number, out),
            Response::Channels(m) => frames.write_numbered(&m, number, out),
            Response::Comparators(m) => frames.write_numbered(&m, number, out),
            Response::Clocks(m) => frames.write_numbered(&m, number, out),
            Response::LinkTested(m) => frames.write_numbered(&m, number, out),
        }
    }
}
