//! The host's end of the link: handshake, commands, events.

use std::time::Duration;

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::RESEND_MINOR;
use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::{ROLE_HOST, check, ours};
use ihd_shared::wire::link_test::Received;
use ihd_shared::wire::messages::{
    ClearFault, Configure, FrontEnd, GetFrontEnd, GetStatus, GetUtilisation, Hello, Message,
    Outcome, Piece, PushLookup, Raw, ReadLookup, Reply, ResendWindow, ResetLookup, SetPower,
    Status, Stream, Utilisation,
};
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;

use super::incoming::{Answer, Event, Incoming};
use super::off::GivingWay;
use super::resend::{Resend, Step};
use super::tap::Tap;
use super::{Counters, FrameSink, LinkError, Transport, printable_hello};

/// How long a command waits for its answer unless [`Client::set_timeout`] changes it.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(2);

/// How often a host that wants its power to stay on is heard, with or without a question: the device ends it after
/// [`HOST_UNHEARD_HALF_CYCLES`], 10 s at 50 Hz.
pub const HEARD_EVERY: Duration = Duration::from_millis(HOST_UNHEARD_HALF_CYCLES as u64 * 10 / 5);

/// Times that a command which may come twice is sent within its time-out: an answer is lost as any frame.
const TRIES: u32 = 3;

/// How long a lookup that was taken may wait for its half-cycle.
const ACTIVE_WITHIN: Duration = Duration::from_millis(200);

/// After a time-out, or a repetition, the next command first discards replies for this long, so that a late one is not
/// taken for its own.
const LATE: Duration = Duration::from_millis(50);

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
    timeout: Duration,
    /// An answer stayed away and may still come.
    owed: bool,
    /// The last command was sent more than once.
    repeated: bool,
    giving_way: GivingWay,
    tap: Tap,
    answers_stray: u32,
    events_dropped: u32,
    resend: Resend,
    /// The device sends pieces of windows again.
    resends: bool,
    pieces_asked: u32,
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
            timeout: DEFAULT_TIMEOUT,
            owed: false,
            repeated: false,
            giving_way: GivingWay::default(),
            tap: Tap::default(),
            answers_stray: 0,
            events_dropped: 0,
            resend: Resend::default(),
            resends: false,
            pieces_asked: 0,
        };
        let theirs = client.ask_again(&ours, "Hello", |answer| match answer {
            Answer::Hello(hello) => Some(printable_hello(hello)),
            _ => None,
        })?;
        check(&ours, &theirs).map_err(|why| LinkError::Mismatch {
            device: format!("{} ({})", client.transport.describe(), theirs.build),
            why,
        })?;
        // What came before the hello was for somebody else.
        client.incoming.events.clear();
        client.resends = theirs.protocol_minor >= RESEND_MINOR;
        client.hello = theirs;
        client.front_end = client.await_front_end()?;
        Ok(client)
    }

    /// The device sends it behind its hello; asked for where that frame was lost.
    fn await_front_end(&mut self) -> Result<FrontEnd, LinkError> {
        let wanted = |answer| match answer {
            Answer::FrontEnd(front_end) => Some(front_end),
            _ => None,
        };
        let before = self.incoming.counters();
        match self.await_answer(GetFrontEnd::ID, "GetFrontEnd", LATE, &before, wanted) {
            Err(LinkError::NoAnswer { .. }) => {
                self.ask_again(&GetFrontEnd {}, "GetFrontEnd", wanted)
            }
            answer => answer,
        }
    }

    /// What the codes of the device's channels stand for.
    pub fn front_end(&self) -> &FrontEnd {
        &self.front_end
    }

    /// How the device describes itself.
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

    /// How long a command waits for its answer, on the transport's clock.
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
        self.order_again(&SetPower { power_w }, "SetPower")
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
        self.order_again(&stream, "Stream")
    }

    /// The controller now.
    ///
    /// # Errors
    /// As every command.
    pub fn status(&mut self) -> Result<Status, LinkError> {
        self.ask_again(&GetStatus {}, "GetStatus", |answer| match answer {
            Answer::Status(status) => Some(status),
            _ => None,
        })
    }

    /// How busy the controller was since this was asked last.
    ///
    /// # Errors
    /// As every command.
    pub fn utilisation(&mut self) -> Result<Utilisation, LinkError> {
        self.ask_again(
            &GetUtilisation {},
            "GetUtilisation",
            |answer| match answer {
                Answer::Utilisation(utilisation) => Some(utilisation),
                _ => None,
            },
        )
    }

    /// Offers a lookup. Taken, it becomes active at the next half-cycle boundary, which
    /// [`Client::status`] shows; refused, the device keeps the one it has.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with the device's reason, else as every command.
    pub fn push_lookup(&mut self, lookup: &RlLookup) -> Result<(), LinkError> {
        self.push_lookup_bytes(&lookup.to_bytes())
    }

    /// As [`Client::push_lookup`], for bytes that may be no lookup at all: the device judges. Where the answer
    /// stays away the push is repeated; a repetition that is refused because the first was taken is a success.
    ///
    /// # Errors
    /// As [`Client::push_lookup`]; [`LinkError::Unsendable`] for more bytes than a frame holds.
    pub fn push_lookup_bytes(&mut self, blob: &[u8]) -> Result<(), LinkError> {
        let pushed = self.order_again(&PushLookup { blob: Raw(blob) }, "PushLookup");
        self.or_done_before(pushed, |client| {
            client.lookup_bytes().is_ok_and(|active| active == blob)
        })
    }

    /// The active lookup.
    ///
    /// # Errors
    /// [`LinkError::DamagedLookup`] when it fails the checks, else as every command.
    pub fn read_lookup(&mut self) -> Result<RlLookup, LinkError> {
        let blob = self.lookup_bytes()?;
        RlLookup::from_bytes(&blob).map_err(|source| LinkError::DamagedLookup {
            device: self.describe(),
            source,
        })
    }

    fn lookup_bytes(&mut self) -> Result<Vec<u8>, LinkError> {
        self.ask_again(&ReadLookup {}, "ReadLookup", |answer| match answer {
            Answer::Lookup(blob) => Some(blob),
            _ => None,
        })
    }

    /// Back to the built-in lookup, version 0, at the next half-cycle boundary.
    ///
    /// # Errors
    /// As every command.
    pub fn reset_lookup(&mut self) -> Result<(), LinkError> {
        let reset = self.order_again(&ResetLookup {}, "ResetLookup");
        self.or_done_before(reset, |client| {
            client
                .status()
                .is_ok_and(|status| status.lookup_version == 0)
        })
    }

    /// Whether a refusal only says that a repeated command had been done the first time, which `is_done` sees.
    fn or_done_before(
        &mut self,
        outcome: Result<(), LinkError>,
        mut is_done: impl FnMut(&mut Self) -> bool,
    ) -> Result<(), LinkError> {
        let (Err(LinkError::Refused { outcome: why, .. }), true) = (&outcome, self.repeated) else {
            return outcome;
        };
        if !matches!(why, Outcome::LookupStale | Outcome::Busy) {
            return outcome;
        }
        let deadline = self.transport.clock() + ACTIVE_WITHIN;
        while !is_done(self) && !self.giving_way.is_wanted() {
            let left = deadline.saturating_sub(self.transport.clock());
            if left.is_zero() {
                return outcome;
            }
            // Half a half-cycle.
            self.receive(left.min(Duration::from_millis(5)))?;
        }
        Ok(())
    }

    /// Changes the device's settings until its next boot.
    ///
    /// # Errors
    /// [`LinkError::Refused`] when one is outside its range, else as every command.
    pub fn configure(&mut self, settings: &Configure) -> Result<(), LinkError> {
        self.order_again(settings, "Configure")
    }

    /// Leaves the safe state after a fault; power must be asked for again.
    ///
    /// # Errors
    /// As every command.
    pub fn clear_fault(&mut self) -> Result<(), LinkError> {
        self.order_again(&ClearFault {}, "ClearFault")
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
            self.drop_answers();
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
            self.drop_answers();
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

    /// A command that is answered by a [`Reply`], and that may come twice.
    pub(super) fn order_again<M: Message>(
        &mut self,
        message: &M,
        command: &'static str,
    ) -> Result<(), LinkError> {
        self.ask_again(message, command, |answer| match answer {
            Answer::Reply(Reply { to, .. }) if to == M::ID => Some(()),
            _ => None,
        })
    }

    /// A command that may come twice: it is sent several times within the time-out if need be.
    pub(super) fn ask_again<M: Message, T>(
        &mut self,
        message: &M,
        command: &'static str,
        wanted: impl Fn(Answer) -> Option<T>,
    ) -> Result<T, LinkError> {
        self.ask_times(TRIES, message, command, wanted)
    }

    /// A command that is sent once.
    pub(super) fn ask<M: Message, T>(
        &mut self,
        message: &M,
        command: &'static str,
        wanted: impl Fn(Answer) -> Option<T>,
    ) -> Result<T, LinkError> {
        self.ask_times(1, message, command, wanted)
    }

    fn ask_times<M: Message, T>(
        &mut self,
        tries: u32,
        message: &M,
        command: &'static str,
        wanted: impl Fn(Answer) -> Option<T>,
    ) -> Result<T, LinkError> {
        self.forget_answers()?;
        self.repeated = false;
        self.giving_way.is_told = false;
        // Faults of the link seen so far do not explain a missing answer to this command.
        let before = self.incoming.counters();
        let mut left = tries;
        loop {
            left -= 1;
            let mut frame = [0; MAX_ENCODED];
            let length = self.framed(message, command, &mut frame)?;
            self.transport.send(&frame[..length])?;
            self.tap.give(self.transport.clock(), &frame[..length]);
            let answer = self.await_answer(M::ID, command, self.timeout / tries, &before, &wanted);
            // All that were sent may be answered in the end.
            self.owed |= self.repeated;
            match answer {
                Err(LinkError::NoAnswer { .. }) if self.giving_way.is_told => {
                    return Err(LinkError::GaveWay { command });
                }
                Err(LinkError::NoAnswer { .. }) if left > 0 => self.repeated = true,
                answer => return answer,
            }
        }
    }

    /// The answer to the command of number `id`, as `wanted` knows it.
    fn await_answer<T>(
        &mut self,
        id: u8,
        command: &'static str,
        timeout: Duration,
        before: &Counters,
        wanted: impl Fn(Answer) -> Option<T>,
    ) -> Result<T, LinkError> {
        let start = self.transport.clock();
        let mut timeout = timeout;
        loop {
            while let Some(answer) = self.incoming.answers.pop_front() {
                if let Answer::Reply(reply) = &answer
                    && reply.to == id
                    && reply.outcome != Outcome::Ok
                    // A device that refuses our hello sends its own first, which shows why.
                    && id != Hello::ID
                {
                    return Err(LinkError::Refused {
                        command,
                        outcome: reply.outcome,
                        detail: reply.detail,
                    });
                }
                match wanted(answer) {
                    Some(answer) => return Ok(answer),
                    None => self.answers_stray = self.answers_stray.wrapping_add(1),
                }
            }
            let waited = self.transport.clock().saturating_sub(start);
            if let Some(grace) = self.give_way(id)? {
                timeout = timeout.min(waited + grace);
            }
            let left = timeout.saturating_sub(waited);
            let slice = left.min(self.giving_way.look_every());
            if left.is_zero() || (self.receive(slice)? == 0 && slice == left) {
                self.owed = true;
                return Err(self.no_answer(command, before));
            }
        }
    }

    /// Sees whether somebody waits to switch off, and tells the device at once. Returns how long the command of number `id` still
    /// waits for its answer then.
    fn give_way(&mut self, id: u8) -> Result<Option<Duration>, LinkError> {
        if self.giving_way.is_told || !self.giving_way.is_wanted() {
            return Ok(None);
        }
        self.giving_way.is_told = true;
        self.tell_off()?;
        // Two answers to one kind of command cannot be told apart, and this one's repetition would heat.
        let grace = if id == SetPower::ID {
            Duration::ZERO
        } else {
            LATE
        };
        Ok(Some(grace))
    }

    /// Tells the device to switch off, and does not wait for its answer.
    pub(super) fn tell_off(&mut self) -> Result<(), LinkError> {
        self.owed = true;
        self.send_unanswered(&SetPower { power_w: 0 }, "SetPower")
    }

    /// Returns `true` if an answer stayed away and may still come.
    pub(super) fn is_owed(&self) -> bool {
        self.owed
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

    /// Answers that come without a command, or after it was given up, are not the next one's.
    fn forget_answers(&mut self) -> Result<(), LinkError> {
        if self.owed {
            self.owed = false;
            let deadline = self.transport.clock() + LATE;
            loop {
                let left = deadline.saturating_sub(self.transport.clock());
                if left.is_zero() || self.receive(left)? == 0 {
                    break;
                }
                self.drop_answers();
            }
        }
        self.drop_answers();
        Ok(())
    }

    fn drop_answers(&mut self) {
        let stray = self.incoming.answers.len() as u32;
        self.answers_stray = self.answers_stray.wrapping_add(stray);
        self.incoming.answers.clear();
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
        self.take_refusals();
        self.let_go_of_windows(known)?;
        self.limit_events();
        Ok(length)
    }

    /// What the device answers to requests that no command waits for.
    fn take_refusals(&mut self) {
        let (mut gone, mut unknown) = (None, false);
        self.incoming.answers.retain(|answer| match answer {
            Answer::Reply(reply) if reply.to == ResendWindow::ID => {
                match reply.outcome {
                    Outcome::OutOfRange => gone = Some(reply.detail),
                    _ => unknown = true,
                }
                false
            }
            _ => true,
        });
        if let Some(seq) = gone {
            self.incoming.give_up(seq);
        }
        if unknown {
            self.resends = false;
        }
    }

    /// Lets the device forget the windows that have been given out or rejected since there were `known` events.
    fn let_go_of_windows(&mut self, known: usize) -> Result<(), LinkError> {
        if !self.resends {
            return Ok(());
        }
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
            match self.resend.step(now, window.as_ref(), self.resends) {
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
            let length = self.framed(request, "ResendWindow", &mut frame)?;
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

    /// Sends a message that nobody answers.
    pub(super) fn send_unanswered<M: Message>(
        &mut self,
        message: &M,
        command: &'static str,
    ) -> Result<(), LinkError> {
        let mut frame = [0; MAX_ENCODED];
        let length = self.framed(message, command, &mut frame)?;
        self.tap.give(self.transport.clock(), &frame[..length]);
        self.transport.send(&frame[..length])
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
        command: &'static str,
        frame: &mut [u8; MAX_ENCODED],
    ) -> Result<usize, LinkError> {
        let length = encode(message, self.frame_seq, frame)
            .map_err(|source| LinkError::Unsendable { command, source })?;
        self.frame_seq = self.frame_seq.wrapping_add(1);
        Ok(length)
    }
}

#[cfg(test)]
mod hostile_tests;
