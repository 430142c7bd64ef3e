//! The host's end of the link: handshake, requests, events.

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, check, ours};
use ihd_shared::wire::link_test::Received;
use ihd_shared::wire::messages::{
    ClearFault, Configure, FrontEnd, GetFrontEnd, GetStatus, GetUtilisation, Hello, Message,
    Outcome, Piece, PushLookup, Raw, ReadLookup, Reply, Request, ResendWindow, ResetLookup,
    SetPower, Status, Stream, Utilisation,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;
use serde::Deserialize;

use super::incoming::{Answer, Event, Incoming};
use super::off::GivingWay;
use super::resend::{Resend, Step};
use super::tap::Tap;
use super::{Counters, FrameSink, LinkError, Transport, printable_hello};

/// Time that a command waits for its answer unless [`Client::set_timeout`] changes it.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(2);

/// Longest silence of a host that wants its power to stay on: the device ends it after [`HOST_UNHEARD_HALF_CYCLES`], 10 s at
/// 50 Hz.
pub const HEARD_EVERY: Duration = Duration::from_millis(HOST_UNHEARD_HALF_CYCLES as u64 * 10 / 5);

/// Times that a request is sent within its time-out: an answer is lost as any frame.
const TRIES: u32 = 3;

/// Time that a command that gives way to an `off` still waits for its answer.
const GRACE: Duration = Duration::from_millis(50);

/// Events that may wait for [`Client::next_event`] while commands are answered; a window takes
/// 70 kB.
const MAX_EVENTS: usize = 256;

/// Reads that [`Client::next_event`] makes of what is there when its time is over, and for how long: a whole window
/// comes in a thousand packets over USB. The number is for clocks that stand still meanwhile.
const OVERTIME_READS: u32 = 4_096;
const OVERTIME: Duration = Duration::from_millis(50);

/// A device, connected and compatible.
pub struct Client {
    transport: Box<dyn Transport>,
    incoming: Incoming,
    hello: Hello,
    front_end: FrontEnd,
    frame_seq: u16,
    /// Number of the last request.
    number: Number,
    awaited: Option<Awaited>,
    /// Answer that was awaited last, once it has come.
    answer: Option<Answer>,
    timeout: Duration,
    giving_way: GivingWay,
    tap: Tap,
    answers_stray: u32,
    events_dropped: u32,
    resend: Resend,
    pieces_asked: u32,
}

/// Answer that is waited for.
#[derive(Clone, Copy)]
struct Awaited {
    id: u8,
    number: Number,
}

impl Awaited {
    /// The message asked for, or a refusal of it.
    fn is(self, answer: &Answer) -> bool {
        let is_refusal = || {
            let reply: Option<Reply> = answer.decode();
            reply.is_some_and(|reply| reply.outcome != Outcome::Ok)
        };
        answer.number() == self.number && (answer.id() == self.id || is_refusal())
    }
}

impl Client {
    /// Shakes hands with the device behind `transport`.
    ///
    /// # Errors
    /// [`LinkError::Mismatch`] when the two do not fit, [`LinkError::NoAnswer`] when no hello
    /// comes, and what the transport reports.
    pub fn connect(transport: Box<dyn Transport>) -> Result<Self, LinkError> {
        let build = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));
        let ours = ours(ROLE_HOST, 0, std::process::id(), build, "host");
        let mut client = Self {
            transport,
            incoming: Incoming::default(),
            hello: ours.clone(),
            // Before the device has told.
            front_end: FrontEnd {
                v_full_scale_mv: 0,
                i_full_scale_ma: 0,
                bus_full_scale_mv: 0,
                mains_full_scale_mv: 0,
                bits: 0,
            },
            frame_seq: 0,
            number: Number::NONE,
            awaited: None,
            answer: None,
            timeout: DEFAULT_TIMEOUT,
            giving_way: GivingWay::default(),
            tap: Tap::default(),
            answers_stray: 0,
            events_dropped: 0,
            resend: Resend::default(),
            pieces_asked: 0,
        };
        let greeted = Awaited {
            id: Hello::ID,
            number: Number::NONE,
        };
        let theirs: Hello = client.exchange(&ours, greeted, TRIES)?;
        let theirs = printable_hello(theirs);
        check(&ours, &theirs).map_err(|why| LinkError::Mismatch {
            device: format!("{} ({})", client.transport.describe(), theirs.build),
            why,
        })?;
        // What came before the hello was for somebody else.
        client.incoming.events.clear();
        client.hello = theirs;
        client.front_end = client.request(&GetFrontEnd {})?;
        Ok(client)
    }

    /// Asks for what the table binds to the request. While the answer stays away the request is sent again under the same
    /// number, within the time-out; an answer under any other number is not taken for it.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with the device's outcome, [`LinkError::NoAnswer`], [`LinkError::Unsendable`] for more bytes
    /// than a frame holds, and what the transport reports.
    pub fn request<R: Request>(&mut self, request: &R) -> Result<R::Answer<'_>, LinkError> {
        self.number = self.number.next();
        let awaited = Awaited {
            id: <R::Answer<'_> as Message>::ID,
            number: self.number,
        };
        let tries = if R::IS_SENT_ONCE { 1 } else { TRIES };
        self.exchange(request, awaited, tries)
    }

    /// Makes a request of which the answer is only that it was done.
    pub(super) fn order<R>(&mut self, order: &R) -> Result<(), LinkError>
    where
        R: for<'a> Request<Answer<'a> = Reply>,
    {
        self.request(order).map(|_: Reply| ())
    }

    /// Scales of the codes of the device's channels.
    pub fn front_end(&self) -> &FrontEnd {
        &self.front_end
    }

    /// Description of the device, by itself.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The device in words.
    pub fn describe(&self) -> String {
        self.transport.describe()
    }

    /// Everything seen and missed so far.
    pub fn counters(&self) -> Counters {
        Counters {
            answers_stray: self.answers_stray,
            events_dropped: self.events_dropped,
            pieces_asked: self.pieces_asked,
            ..self.incoming.counters()
        }
    }

    /// The transport's clock, which every time-out is measured with; only differences mean something.
    pub fn clock(&self) -> Duration {
        self.transport.clock()
    }

    /// Sets the time that a command waits for its answer, on the transport's clock.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Copies every frame from now on to `sink`.
    pub fn record_to(&mut self, sink: impl FrameSink + 'static) {
        self.tap.open(Box::new(sink));
    }

    /// Ends the recording; without one, nothing.
    ///
    /// # Errors
    /// [`LinkError::Recording`] when it, or a part of it before, could not be written.
    pub fn finish_recording(&mut self) -> Result<(), LinkError> {
        self.tap.close().map_err(LinkError::Recording)
    }

    /// Asks for a mean power in watt; 0 switches off.
    ///
    /// # Errors
    /// [`LinkError::Refused`] above the rating or while a fault is active, else as every command:
    /// [`LinkError::NoAnswer`] or what the transport reports.
    pub fn set_power(&mut self, power_w: u16) -> Result<(), LinkError> {
        self.order(&SetPower { power_w })
    }

    /// Chooses a telemetry and a window every so many half-cycles; 0 for none.
    ///
    /// # Errors
    /// As every command.
    pub fn stream(&mut self, telemetry_every: u8, windows_every: u8) -> Result<(), LinkError> {
        let stream = Stream {
            telemetry_every,
            windows_every,
        };
        self.order(&stream)
    }

    /// The controller now.
    ///
    /// # Errors
    /// As every command.
    pub fn status(&mut self) -> Result<Status, LinkError> {
        self.request(&GetStatus {})
    }

    /// Load of the controller since this was asked last.
    ///
    /// # Errors
    /// As every command.
    pub fn utilisation(&mut self) -> Result<Utilisation, LinkError> {
        self.request(&GetUtilisation {})
    }

    /// Offers a lookup. Taken, it becomes active at the next half-cycle boundary, which
    /// [`Client::status`] shows; refused, the device keeps the one it has.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with the device's reason, else as every command.
    pub fn push_lookup(&mut self, lookup: &RlLookup) -> Result<(), LinkError> {
        self.push_lookup_bytes(&lookup.to_bytes())
    }

    /// Pushes bytes that may be no lookup at all: the device judges.
    ///
    /// # Errors
    /// As [`Client::push_lookup`]; [`LinkError::Unsendable`] for more bytes than a frame holds.
    pub fn push_lookup_bytes(&mut self, blob: &[u8]) -> Result<(), LinkError> {
        self.order(&PushLookup { blob: Raw(blob) })
    }

    /// The active lookup.
    ///
    /// # Errors
    /// [`LinkError::DamagedLookup`] when it fails the checks, else as every command.
    pub fn read_lookup(&mut self) -> Result<RlLookup, LinkError> {
        let device = self.describe();
        let read = self.request(&ReadLookup {})?;
        RlLookup::from_bytes(read.blob.0)
            .map_err(|source| LinkError::DamagedLookup { device, source })
    }

    /// Back to the built-in lookup, version 0, at the next half-cycle boundary.
    ///
    /// # Errors
    /// As every command.
    pub fn reset_lookup(&mut self) -> Result<(), LinkError> {
        self.order(&ResetLookup {})
    }

    /// Changes the device's settings until its next boot.
    ///
    /// # Errors
    /// [`LinkError::Refused`] when one is outside its range, else as every command.
    pub fn configure(&mut self, settings: &Configure) -> Result<(), LinkError> {
        self.order(settings)
    }

    /// Leaves the safe state after a fault; power must be asked for again.
    ///
    /// # Errors
    /// As every command.
    pub fn clear_fault(&mut self) -> Result<(), LinkError> {
        self.order(&ClearFault {})
    }

    /// The next event, in the order the device sent them; `None` when `timeout` has passed on the
    /// transport's clock, whatever else has come meanwhile. A zero `timeout` takes what is there, within
    /// bounds: a device that sends without end and completes nothing is left after 50 ms.
    ///
    /// # Errors
    /// [`LinkError::Recording`] once when the recording fails, and what the transport reports.
    pub fn next_event(&mut self, timeout: Duration) -> Result<Option<Event>, LinkError> {
        let deadline = self.transport.clock() + timeout;
        let mut overtime_reads = 0;
        loop {
            if let Some(error) = self.tap.take_failure() {
                return Err(LinkError::Recording(error));
            }
            if let Some(event) = self.incoming.events.pop_front() {
                return Ok(Some(event));
            }
            let now = self.transport.clock();
            let left = deadline.saturating_sub(now);
            overtime_reads += u32::from(left.is_zero());
            if overtime_reads > OVERTIME_READS || now.saturating_sub(deadline) > OVERTIME {
                return Ok(None);
            }
            let length = self.receive(left)?;
            if length == 0 {
                return Ok(self.incoming.events.pop_front());
            }
        }
    }

    /// Takes what comes within `timeout`, for whoever cannot take an event now. When too many wait, telemetry
    /// is dropped; when too many are none, the bytes stay with the transport: what the device then finds
    /// no room for it counts itself.
    #[cfg(feature = "async")]
    pub(crate) fn wait_without_events(&mut self, timeout: Duration) -> Result<(), LinkError> {
        let events = &mut self.incoming.events;
        if events.len() >= MAX_EVENTS / 2 {
            let before = events.len();
            events.retain(|event| !matches!(event, Event::Telemetry(_)));
            let dropped = (before - events.len()) as u32;
            self.events_dropped = self.events_dropped.wrapping_add(dropped);
        }
        if self.incoming.events.len() < MAX_EVENTS / 2 {
            self.receive(timeout)?;
        } else {
            std::thread::sleep(timeout);
        }
        Ok(())
    }

    /// An event was dropped by whoever passes them on.
    #[cfg(feature = "async")]
    pub(crate) fn count_dropped_event(&mut self) {
        self.events_dropped = self.events_dropped.wrapping_add(1);
    }

    /// Sends a message, so often within the time-out, until what is awaited is here.
    fn exchange<'s, M: Message, A: Message + Deserialize<'s>>(
        &'s mut self,
        message: &M,
        awaited: Awaited,
        tries: u32,
    ) -> Result<A, LinkError> {
        // Faults of the link seen so far do not explain a missing answer to this one.
        let before = self.incoming.counters();
        self.giving_way.is_told = false;
        self.answer = None;
        self.awaited = Some(awaited);
        let came = self.send_until_answered(message, awaited.number, tries);
        // What comes later comes too late.
        self.awaited = None;
        came?;
        let answer = self.answer.as_ref();
        if let Some(Reply { outcome, detail }) = answer.and_then(|answer| answer.decode())
            && outcome != Outcome::Ok
        {
            return Err(LinkError::Refused {
                command: M::NAME,
                outcome,
                detail,
            });
        }
        let answer = answer.and_then(|answer| answer.decode());
        answer.ok_or_else(|| match self.giving_way.is_told {
            true => LinkError::GaveWay { command: M::NAME },
            false => self.no_answer(M::NAME, &before),
        })
    }

    fn send_until_answered<M: Message>(
        &mut self,
        message: &M,
        number: Number,
        tries: u32,
    ) -> Result<(), LinkError> {
        for _ in 0..tries {
            self.send(message, number)?;
            let mut deadline = self.transport.clock() + self.timeout / tries;
            while self.answer.is_none() {
                let now = self.transport.clock();
                if let Some(grace) = self.give_way(M::ID)? {
                    deadline = deadline.min(now + grace);
                }
                let left = deadline.saturating_sub(now);
                let slice = left.min(self.giving_way.look_every());
                if left.is_zero() || (self.receive(slice)? == 0 && slice == left) {
                    break;
                }
            }
            if self.answer.is_some() || self.giving_way.is_told {
                break;
            }
        }
        Ok(())
    }

    /// Sees whether somebody waits to switch off, and tells the device at once. Returns how long the command of number `id` still
    /// waits for its answer then.
    fn give_way(&mut self, id: u8) -> Result<Option<Duration>, LinkError> {
        if self.giving_way.is_told || !self.giving_way.is_wanted() {
            return Ok(None);
        }
        self.giving_way.is_told = true;
        self.number = self.number.next();
        self.send(&SetPower { power_w: 0 }, self.number)?;
        // Whoever asked for power gets none.
        Ok(Some(match id {
            SetPower::ID => Duration::ZERO,
            _ => GRACE,
        }))
    }

    pub(super) fn giving_way(&mut self) -> &mut GivingWay {
        &mut self.giving_way
    }

    fn no_answer(&self, command: &'static str, before: &Counters) -> LinkError {
        let now = self.incoming.counters();
        let seen = match (
            now.frames_good.wrapping_sub(before.frames_good),
            now.bytes - before.bytes,
        ) {
            (0, 0) => "nothing came at all: is it powered and running?".into(),
            (0, bytes) => format!("{bytes} bytes came, but no frame: is it an ihd device?"),
            (frames, _) => format!("{frames} other frames came"),
        };
        LinkError::NoAnswer {
            device: self.describe(),
            command,
            after: self.timeout,
            seen,
        }
    }

    /// Takes what comes within `timeout`, and asks for the missing pieces of windows meanwhile; returns
    /// how many bytes it was.
    pub(super) fn receive(&mut self, timeout: Duration) -> Result<usize, LinkError> {
        let start = self.transport.clock();
        loop {
            let pause = self.ask_for_pieces()?;
            let now = self.transport.clock();
            let left = timeout.saturating_sub(now.saturating_sub(start));
            let length = self.read(left.min(pause))?;
            if length > 0 || left <= pause {
                // Asked for now rather than with the next call, which may be late.
                self.ask_for_pieces()?;
                return Ok(length);
            }
        }
    }

    /// Takes what comes within `timeout`; returns how many bytes it was.
    fn read(&mut self, timeout: Duration) -> Result<usize, LinkError> {
        let mut buf = [0; 16 * 1024];
        let length = self.transport.receive(&mut buf, timeout)?;
        let bytes = &buf[..length];
        let known = self.incoming.events.len();
        for &byte in bytes {
            // Bad frames are in the counters.
            let _ = self.incoming.push(byte);
        }
        self.tap.take(self.transport.clock(), bytes);
        self.take_answers();
        self.let_go_of_windows(known)?;
        self.limit_events();
        Ok(length)
    }

    /// Picks the answer that is awaited; no other is anybody's.
    fn take_answers(&mut self) {
        while let Some(answer) = self.incoming.answers.pop_front() {
            if self.awaited.is_some_and(|awaited| awaited.is(&answer)) {
                self.answer = Some(answer);
                self.awaited = None;
            } else {
                self.answers_stray = self.answers_stray.wrapping_add(1);
            }
        }
    }

    /// Lets the device forget the windows that have been given out or rejected since there were `known` events.
    fn let_go_of_windows(&mut self, known: usize) -> Result<(), LinkError> {
        let newest = self.incoming.events.iter().skip(known).rev();
        let seq = newest.into_iter().find_map(|event| match event {
            Event::Window(window) => Some(window.seq),
            Event::WindowRejected { seq, .. } => Some(*seq),
            Event::Telemetry(_) | Event::Fault(_) | Event::Log { .. } => None,
        });
        // The device has one window at a time: those before it are gone.
        let let_go = seq.map(|seq| ResendWindow {
            seq,
            piece: Piece::Nothing,
            offset: 0,
        });
        self.send_requests(let_go.as_slice())
    }

    /// Asks for what is missing of the window under way when it is time; returns how long it is not.
    fn ask_for_pieces(&mut self) -> Result<Duration, LinkError> {
        loop {
            let now = self.transport.clock();
            let window = self.incoming.unfinished();
            match self.resend.step(now, window.as_ref()) {
                Step::Wait(pause) => return Ok(pause),
                Step::GiveUp(seq) => self.incoming.give_up(seq),
                Step::Ask(pieces) => {
                    self.pieces_asked = self.pieces_asked.wrapping_add(pieces.len() as u32);
                    self.send_requests(&pieces)?;
                }
            }
        }
    }

    fn send_requests(&mut self, requests: &[ResendWindow]) -> Result<(), LinkError> {
        let mut frames = Vec::new();
        for request in requests {
            let mut frame = [0; MAX_ENCODED];
            let length = self.framed(request, Number::NONE, &mut frame)?;
            self.tap.give(self.transport.clock(), &frame[..length]);
            frames.extend_from_slice(&frame[..length]);
        }
        if frames.is_empty() {
            return Ok(());
        }
        self.transport.send(&frames)
    }

    /// Keeps the events that wait within bounds: telemetry goes first, then the oldest.
    fn limit_events(&mut self) {
        let events = &mut self.incoming.events;
        let excess = events.len().saturating_sub(MAX_EVENTS);
        if excess == 0 {
            return;
        }
        let mut left = excess;
        events.retain(|event| {
            let goes = left > 0 && matches!(event, Event::Telemetry(_));
            left -= usize::from(goes);
            !goes
        });
        events.drain(..left);
        self.events_dropped = self.events_dropped.wrapping_add(excess as u32);
    }

    /// Sends a message.
    pub(super) fn send<M: Message>(
        &mut self,
        message: &M,
        number: Number,
    ) -> Result<(), LinkError> {
        let mut frame = [0; MAX_ENCODED];
        let length = self.framed(message, number, &mut frame)?;
        self.transport.send(&frame[..length])?;
        self.tap.give(self.transport.clock(), &frame[..length]);
        Ok(())
    }

    /// Forgets the bytes of a test of the link that have come.
    pub(super) fn forget_link_data(&mut self) {
        self.incoming.link_data = Received::NONE;
    }

    /// The bytes of a test of the link that have come.
    pub(super) fn link_data(&self) -> Received {
        self.incoming.link_data
    }

    fn framed<M: Message>(
        &mut self,
        message: &M,
        number: Number,
        frame: &mut [u8; MAX_ENCODED],
    ) -> Result<usize, LinkError> {
        let length = encode_numbered(message, number, self.frame_seq, frame).map_err(|source| {
            let command = M::NAME;
            LinkError::Unsendable { command, source }
        })?;
        self.frame_seq = self.frame_seq.wrapping_add(1);
        Ok(length)
    }
}

#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod pairing_tests;
