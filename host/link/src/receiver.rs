//! Receiving side of a link: deframer, decoding, window assembler and their counters.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::FrameError;
use ihd_shared::wire::link_test::LinkTestCounts;
use ihd_shared::wire::messages::{
    AnyMessage, DecodeError, FaultEvent, Hello, Message, Telemetry, decode, part_of,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::schema::Part;
use serde::Deserialize;

use super::ClientCounters;
use super::assembler::{Assembler, RejectedWindow, UnfinishedWindow};
use super::flood::Flood;
use super::window::{Window, WindowDefect};

/// Message that a device sends without a request.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceEvent {
    /// One half-cycle in numbers.
    Telemetry(Telemetry),
    /// A window, complete and checked.
    Window(Box<Window>),
    /// A fault tripped or was cleared.
    Fault(FaultEvent),
    /// A window arrived with a defect and was not used.
    WindowRejected {
        /// Its number.
        seq: u32,
        /// Reason.
        reason: WindowDefect,
    },
    /// Log of the firmware, enabled by [`super::Client::stream_log`].
    Log {
        /// Bytes of log before these since the device's boot: a jump means loss on the link.
        seq: u32,
        /// Log frames since boot that the device had no room for.
        dropped: u32,
        /// Whole rzCOBS frames of defmt, each ended by a 0.
        data: Vec<u8>,
    },
}

/// Response to a request, or a hello. The bytes are those of a message with this id.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawResponse {
    id: u8,
    number: Number,
    bytes: Vec<u8>,
}

impl RawResponse {
    /// Id of the message.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// Number of the request; [`Number::NONE`] for a hello.
    pub fn number(&self) -> Number {
        self.number
    }

    /// Decodes the message; `None` if it is of another kind.
    pub fn decode<'a, M: Message + Deserialize<'a>>(&'a self) -> Option<M> {
        (self.id == M::ID).then(|| decode(&self.bytes).ok())?
    }
}

/// Receiving side of a link, or of a recording of one.
#[derive(Default)]
pub struct Receiver {
    deframer: Deframer,
    assembler: Assembler,
    counters: ClientCounters,
    flood: Option<Flood>,
    /// Counters of the link test.
    pub(super) link_data: LinkTestCounts,
    /// Events in the order of their last byte.
    pub events: VecDeque<DeviceEvent>,
    /// Answers in the order of their last byte.
    pub answers: VecDeque<RawResponse>,
}

impl Receiver {
    /// Counters so far.
    pub fn counters(&self) -> ClientCounters {
        let frames = self.deframer.counters();
        ClientCounters {
            frames_good: frames.good,
            frames_bad: frames.bad,
            frames_lost: frames.lost,
            window_messages_stray: self.assembler.stray(),
            ..self.counters.clone()
        }
    }

    /// Processes one byte; completed messages are appended to `events` and `answers`.
    ///
    /// # Errors
    /// [`FrameError`] if the byte ends a run that is no frame. It is counted, and decoding continues with the next frame.
    pub fn push(&mut self, byte: u8) -> Result<(), FrameError> {
        self.counters.bytes += 1;
        match self.deframer.collect(&[byte]) {
            (_, true) => self.take_frame(),
            _ => Ok(()),
        }
    }

    /// Drops from now on what is beyond a hob's rates, by a clock of which it is `now`.
    pub(super) fn limit_floods(&mut self, now: Duration) {
        self.flood = Some(Flood::new(now));
    }

    /// Takes bytes that came `now`; bad frames are in the counters. `is_awaited` is `true` while a request waits for its answer.
    pub(super) fn take(&mut self, mut bytes: &[u8], is_awaited: bool, now: Duration) {
        self.counters.bytes += bytes.len() as u64;
        while !bytes.is_empty() {
            let (taken, is_end) = self.deframer.collect(bytes);
            bytes = &bytes[taken..];
            if !is_end {
                continue;
            }
            let (flood, id) = (self.flood.as_mut(), self.deframer.id());
            let is_beyond = flood
                .zip(id)
                .is_some_and(|(flood, id)| !flood.takes(id, is_awaited, now));
            if is_beyond {
                self.deframer.skip();
                self.counters.frames_beyond += 1;
            } else {
                let _ = self.take_frame();
            }
        }
    }

    /// Takes the frame that has ended, if it is one.
    fn take_frame(&mut self) -> Result<(), FrameError> {
        let Some(frame) = self.deframer.frame() else {
            return Ok(());
        };
        let frame = frame?;
        let counters = &mut self.counters;
        let (number, payload) = frame.split();
        let is_answer = part_of(frame.id) == Some(Part::Answer) || frame.id == Hello::ID;
        match AnyMessage::decode(frame.id, payload) {
            Ok(_) if is_answer => self.answers.push_back(RawResponse {
                id: frame.id,
                number,
                bytes: payload.to_vec(),
            }),
            Ok(AnyMessage::Telemetry(m)) => {
                counters.telemetry.count_seq(m.seq);
                counters.telemetry.dropped_by_device = m.dropped;
                counters.telemetry.received += 1;
                self.events.push_back(DeviceEvent::Telemetry(m));
            }
            Ok(AnyMessage::LinkData(m)) => self.link_data.take(&m),
            Ok(AnyMessage::Log(m)) => self.events.push_back(DeviceEvent::Log {
                seq: m.seq,
                dropped: m.dropped,
                data: m.data.0.to_vec(),
            }),
            Ok(AnyMessage::FaultEvent(m)) => self.events.push_back(DeviceEvent::Fault(m)),
            Ok(AnyMessage::WindowGone(m)) => self.give_up(m.seq),
            Ok(
                ref m @ (AnyMessage::WindowStart(_)
                | AnyMessage::WindowChunk(_)
                | AnyMessage::TrajectoryChunk(_)
                | AnyMessage::WindowEnd(_)),
            ) => {
                if let AnyMessage::WindowStart(start) = m {
                    counters.windows.dropped_by_device = start.dropped;
                }
                let events = &mut self.events;
                let closed = |result| events.push_back(window_event(result, counters));
                if let Some(seq) = self.assembler.take(m, closed) {
                    self.counters.windows.count_seq(seq);
                    self.counters.windows_begun = self.counters.windows_begun.wrapping_add(1);
                }
            }
            // The rest are requests, which only a host sends.
            Ok(_) | Err(DecodeError::Malformed { .. } | DecodeError::Trailing { .. }) => {
                counters.messages_malformed += 1;
            }
            Err(DecodeError::UnknownId { .. }) => counters.messages_unknown += 1,
        }
        Ok(())
    }

    /// The window that began last; `None` if it is complete.
    pub fn unfinished(&self) -> Option<UnfinishedWindow<'_>> {
        self.assembler.unfinished()
    }

    /// Rejects a window under way because its missing pieces are not available.
    pub fn give_up(&mut self, seq: u32) {
        if let Some(rejected) = self.assembler.give_up(seq) {
            let event = window_event(Err(rejected), &mut self.counters);
            self.events.push_back(event);
        }
    }

    /// Accepts any sequence number for the next frame, without counting frames as lost.
    pub fn restart_sequence(&mut self) {
        self.deframer.restart_sequence();
    }

    /// Ends the stream: windows under way are rejected.
    pub fn finish(&mut self) {
        while let Some(rejected) = self.assembler.finish() {
            let event = window_event(Err(rejected), &mut self.counters);
            self.events.push_back(event);
        }
    }
}

fn window_event(
    result: Result<Box<Window>, RejectedWindow>,
    counters: &mut ClientCounters,
) -> DeviceEvent {
    match result {
        Ok(window) => {
            counters.windows.received += 1;
            DeviceEvent::Window(window)
        }
        Err(RejectedWindow { seq, reason }) => {
            *counters.windows_rejected.entry(reason.label()).or_default() += 1;
            DeviceEvent::WindowRejected { seq, reason }
        }
    }
}
