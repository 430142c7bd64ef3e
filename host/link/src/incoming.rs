//! From bytes to answers and events: deframer, decoding, window assembler and their counts.

use std::borrow::Cow;
use std::collections::VecDeque;

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::FrameError;
use ihd_shared::wire::link_test::Received;
use ihd_shared::wire::messages::{
    AnyMessage, DecodeError, FaultEvent, Message, Telemetry, decode, is_numbered,
};
use ihd_shared::wire::number::Number;
use serde::Deserialize;

use super::Counters;
use super::assembler::{Assembler, Rejected, Unfinished};
use super::older;
use super::window::{Window, WindowDefect};

/// What a device sends of its own accord.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
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
        /// Why.
        reason: WindowDefect,
    },
    /// What the firmware has logged, once [`super::Client::stream_log`] asks for it.
    Log {
        /// Bytes of log before these, since the device's boot: a gap was lost on the link.
        seq: u32,
        /// Log frames that the device had no room for, since its boot.
        dropped: u32,
        /// Whole rzCOBS frames of defmt, each ended by a 0.
        data: Vec<u8>,
    },
}

/// The answer to a request, or a hello. Its bytes are those of a message of its id.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    id: u8,
    number: Number,
    bytes: Vec<u8>,
}

impl Answer {
    /// Id of the message.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// Number of the request that it answers; [`Number::NONE`] for a hello.
    pub fn number(&self) -> Number {
        self.number
    }

    /// The message, if it is one of this kind.
    pub fn decode<'a, M: Message + Deserialize<'a>>(&'a self) -> Option<M> {
        (self.id == M::ID).then(|| decode(&self.bytes).ok())?
    }
}

/// The receiving end of a link, or of a recording of one.
#[derive(Default)]
pub struct Incoming {
    deframer: Deframer,
    assembler: Assembler,
    counters: Counters,
    /// What comes is of this older major version.
    older: Option<u16>,
    /// Bytes of a test of the link.
    pub(super) link_data: Received,
    /// Events in the order of their last byte.
    pub events: VecDeque<Event>,
    /// Answers in the order of their last byte.
    pub answers: VecDeque<Answer>,
}

impl Incoming {
    /// What has been seen so far.
    pub fn counters(&self) -> Counters {
        let frames = self.deframer.counters();
        Counters {
            frames_good: frames.good,
            frames_bad: frames.bad,
            frames_lost: frames.lost,
            window_messages_stray: self.assembler.stray(),
            ..self.counters.clone()
        }
    }

    /// What comes from now on is of an older major version, or else of ours.
    pub fn set_major(&mut self, major: u16) {
        self.older = older::is_older(major).then_some(major);
    }

    /// Takes one byte; what it completes is found in `events` and `answers`.
    ///
    /// # Errors
    /// [`FrameError`] when the byte ends a run that is no frame; it is counted, and the next frame
    /// is found all the same.
    pub fn push(&mut self, byte: u8) -> Result<(), FrameError> {
        self.counters.bytes += 1;
        let Some(frame) = self.deframer.push(byte) else {
            return Ok(());
        };
        let frame = frame?;
        let counters = &mut self.counters;
        let (number, payload) = match self.older {
            Some(_) if is_numbered(frame.id) => return Ok(()),
            Some(major) => (
                Number::NONE,
                older::completed(major, frame.id, frame.payload),
            ),
            None => {
                let (number, bytes) = frame.split();
                (number, Cow::Borrowed(bytes))
            }
        };
        match AnyMessage::decode(frame.id, &payload) {
            Ok(
                AnyMessage::Hello(_)
                | AnyMessage::Reply(_)
                | AnyMessage::Status(_)
                | AnyMessage::FrontEnd(_)
                | AnyMessage::Utilisation(_)
                | AnyMessage::LookupBlob(_)
                | AnyMessage::ReplayMode(_)
                | AnyMessage::ReplayEstimates(_)
                | AnyMessage::Board(_)
                | AnyMessage::Channels(_)
                | AnyMessage::Comparators(_)
                | AnyMessage::Clocks(_)
                | AnyMessage::LinkTested(_),
            ) => self.answers.push_back(Answer {
                id: frame.id,
                number,
                bytes: payload.into_owned(),
            }),
            Ok(AnyMessage::Telemetry(m)) => {
                counters.telemetry.see(m.seq);
                counters.telemetry.dropped_by_device = m.dropped;
                counters.telemetry.received += 1;
                self.events.push_back(Event::Telemetry(m));
            }
            Ok(AnyMessage::LinkData(m)) => self.link_data.take(&m),
            Ok(AnyMessage::Log(m)) => self.events.push_back(Event::Log {
                seq: m.seq,
                dropped: m.dropped,
                data: m.data.0.to_vec(),
            }),
            Ok(AnyMessage::FaultEvent(m)) => self.events.push_back(Event::Fault(m)),
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
                    self.counters.windows.see(seq);
                    self.counters.windows_begun = self.counters.windows_begun.wrapping_add(1);
                }
            }
            // What only a host sends has no business here.
            Ok(
                AnyMessage::SetPower(_)
                | AnyMessage::Stream(_)
                | AnyMessage::GetStatus(_)
                | AnyMessage::GetUtilisation(_)
                | AnyMessage::PushLookup(_)
                | AnyMessage::ReadLookup(_)
                | AnyMessage::ResetLookup(_)
                | AnyMessage::Configure(_)
                | AnyMessage::GetFrontEnd(_)
                | AnyMessage::ResendWindow(_)
                | AnyMessage::ClearFault(_)
                | AnyMessage::ReplayStart(_)
                | AnyMessage::ReplayBlocks(_)
                | AnyMessage::ReplayEnd(_)
                | AnyMessage::Restart(_)
                | AnyMessage::GetBoard(_)
                | AnyMessage::TestChannels(_)
                | AnyMessage::TestComparators(_)
                | AnyMessage::TestClocks(_)
                | AnyMessage::TestLink(_)
                | AnyMessage::StreamLog(_),
            )
            | Err(DecodeError::Malformed { .. } | DecodeError::Trailing { .. }) => {
                counters.messages_malformed += 1;
            }
            Err(DecodeError::UnknownId { .. }) => counters.messages_unknown += 1,
        }
        Ok(())
    }

    /// The window that began last, while it is not complete.
    pub fn unfinished(&self) -> Option<Unfinished<'_>> {
        self.assembler.unfinished()
    }

    /// Rejects a window that is under way: what is missing is not to be had.
    pub fn give_up(&mut self, seq: u32) {
        if let Some(rejected) = self.assembler.give_up(seq) {
            let event = window_event(Err(rejected), &mut self.counters);
            self.events.push_back(event);
        }
    }

    /// The next frame begins a new sequence: nothing is missing before it.
    pub fn restart_sequence(&mut self) {
        self.deframer.restart_sequence();
    }

    /// The stream is over: a window under way is rejected.
    pub fn finish(&mut self) {
        while let Some(rejected) = self.assembler.finish() {
            let event = window_event(Err(rejected), &mut self.counters);
            self.events.push_back(event);
        }
    }
}

fn window_event(result: Result<Box<Window>, Rejected>, counters: &mut Counters) -> Event {
    match result {
        Ok(window) => {
            counters.windows.received += 1;
            Event::Window(window)
        }
        Err(Rejected { seq, reason }) => {
            *counters.windows_rejected.entry(reason.label()).or_default() += 1;
            Event::WindowRejected { seq, reason }
        }
    }
}
