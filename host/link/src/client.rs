//! Client: handshake, requests, events.

use std::time::Duration;

use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, check, ours};
use ihd_shared::wire::link_test::LinkTestCounts;
use ihd_shared::wire::messages::{
    FrontEnd, GetFrontEnd, Hello, Message, Outcome, Reply, Request, SetPower,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use serde::Deserialize;

use super::frame_tee::FrameTee;
use super::off::OffPreemption;
use super::receiver::{DeviceEvent, RawResponse, Receiver};
use super::resend::Resend;
use super::{ClientCounters, FrameSink, LinkError, Transport, printable_hello};

/// Time that a command waits for its answer unless [`Client::set_timeout`] changes it.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(2);

/// Longest pause between two requests of a host whose power is to stay on. The device switches off after
/// [`HOST_UNHEARD_MS`] without one; this is a fifth of it.
pub const KEEPALIVE_PERIOD: Duration = Duration::from_millis(HOST_UNHEARD_MS as u64 / 5);

/// Number of times that a request is sent within its time-out, since answers get lost like any frame.
const MAX_SENDS: u32 = 3;

/// Time that a preempted command still waits for its answer.
const PREEMPTED_WAIT: Duration = Duration::from_millis(50);

/// Events that may wait for [`Client::next_event`] while commands are answered; a window takes
/// 70 kB.
const MAX_EVENTS: usize = 256;

/// Limits of [`Client::next_event`] for reading available bytes after its time-out: reads and time. A whole window comes in a
/// thousand packets over USB. The number is for clocks that stand still meanwhile.
const MAX_OVERTIME_READS: u32 = 4_096;
const MAX_OVERTIME: Duration = Duration::from_millis(50);

/// A device, connected and compatible.
pub struct Client {
    transport: Box<dyn Transport>,
    receiver: Receiver,
    hello: Hello,
    front_end: FrontEnd,
    frame_seq: u16,
    /// Number of the last request.
    number: Number,
    awaited: Option<AwaitedResponse>,
    /// Response to the last request, once it has come.
    answer: Option<RawResponse>,
    timeout: Duration,
    off_preemption: OffPreemption,
    tap: FrameTee,
    answers_stray: u32,
    events_dropped: u32,
    resend: Resend,
    pieces_asked: u32,
}

/// Response that a request waits for.
#[derive(Clone, Copy)]
struct AwaitedResponse {
    id: u8,
    number: Number,
}

impl AwaitedResponse {
    /// Returns `true` for the expected message or a refusal of the request.
    fn is(self, answer: &RawResponse) -> bool {
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
            receiver: Receiver::default(),
            hello: ours.clone(),
            // Unknown until the device has sent it.
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
            off_preemption: OffPreemption::default(),
            tap: FrameTee::default(),
            answers_stray: 0,
            events_dropped: 0,
            resend: Resend::default(),
            pieces_asked: 0,
        };
        let greeted = AwaitedResponse {
            id: Hello::ID,
            number: Number::NONE,
        };
        let theirs: Hello = client.exchange(&ours, greeted, MAX_SENDS)?;
        let theirs = printable_hello(theirs);
        check(&ours, &theirs).map_err(|why| LinkError::Mismatch {
            device: format!("{} ({})", client.transport.describe(), theirs.build),
            why,
        })?;
        // Events before the hello belong to an earlier conversation.
        client.receiver.events.clear();
        client.hello = theirs;
        client.front_end = client.request(&GetFrontEnd {})?;
        Ok(client)
    }

    /// Makes a request and returns the response that the message table binds to it. While none comes, the request is sent again
    /// under the same number, within the time-out. Responses with another number are ignored.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with the device's outcome, [`LinkError::NoAnswer`], [`LinkError::Unsendable`] for more bytes
    /// than a frame holds, and what the transport reports.
    pub fn request<R: Request>(&mut self, request: &R) -> Result<R::Answer<'_>, LinkError> {
        self.number = self.number.next();
        let awaited = AwaitedResponse {
            id: <R::Answer<'_> as Message>::ID,
            number: self.number,
        };
        let tries = if R::IS_SENT_ONCE { 1 } else { MAX_SENDS };
        self.exchange(request, awaited, tries)
    }

    /// Makes a request whose response is a plain `Reply`.
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

    /// Device in words.
    pub fn describe(&self) -> String {
        self.transport.describe()
    }

    /// Counters so far.
    pub fn counters(&self) -> ClientCounters {
        ClientCounters {
            answers_stray: self.answers_stray,
            events_dropped: self.events_dropped,
            pieces_asked: self.pieces_asked,
            ..self.receiver.counters()
        }
    }

    /// Clock of the transport, which every time-out is measured with; only differences have a meaning.
    pub fn clock(&self) -> Duration {
        self.transport.clock()
    }

    /// Sets the time that a command waits for its answer, on the transport's clock.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Drops from now on what is more than a hob sends of its own accord, before it is decoded: a device that floods must not cost
    /// its host the time that others need. [`ClientCounters::frames_beyond`] counts it.
    pub fn limit_floods(&mut self) {
        self.receiver.limit_floods(self.transport.clock());
    }

    /// Copies every frame from now on to `sink`.
    pub fn record_to(&mut self, sink: impl FrameSink + 'static) {
        self.tap.open(Box::new(sink));
    }

    /// Ends the recording, if there is one.
    ///
    /// # Errors
    /// [`LinkError::Recording`] if any part of it could not be written.
    pub fn finish_recording(&mut self) -> Result<(), LinkError> {
        self.tap.close().map_err(LinkError::Recording)
    }

    /// Lets waiting commands be preempted while `off_waits` returns `true`: they end with [`LinkError::Preempted`].
    #[cfg(feature = "async")]
    pub(crate) fn yield_to_off(&mut self, off_waits: impl Fn() -> bool + Send + 'static) {
        self.off_preemption.off_waits = Some(Box::new(off_waits));
    }

    /// Returns the next event, in the order the device sent them; `None` if `timeout` has passed on the transport's clock. A zero
    /// `timeout` processes the available bytes within bounds: it returns after 50 ms if a device sends without end and completes
    /// nothing.
    ///
    /// # Errors
    /// [`LinkError::Recording`] once when the recording fails, and what the transport reports.
    pub fn next_event(&mut self, timeout: Duration) -> Result<Option<DeviceEvent>, LinkError> {
        let deadline = self.transport.clock() + timeout;
        let mut overtime_reads = 0;
        loop {
            if let Some(error) = self.tap.take_failure() {
                return Err(LinkError::Recording(error));
            }
            if let Some(event) = self.receiver.events.pop_front() {
                return Ok(Some(event));
            }
            let now = self.transport.clock();
            let left = deadline.saturating_sub(now);
            overtime_reads += u32::from(left.is_zero());
            if overtime_reads > MAX_OVERTIME_READS || now.saturating_sub(deadline) > MAX_OVERTIME {
                return Ok(None);
            }
            let length = self.receive(left)?;
            if length == 0 {
                return Ok(self.receiver.events.pop_front());
            }
        }
    }

    /// Receives for `timeout` while the caller cannot accept an event. Telemetry is dropped if too many events wait. If that is not
    /// enough, the bytes stay with the transport, and the device counts what it has no room for.
    #[cfg(feature = "async")]
    pub(crate) fn wait_without_events(&mut self, timeout: Duration) -> Result<(), LinkError> {
        let events = &mut self.receiver.events;
        if events.len() >= MAX_EVENTS / 2 {
            let before = events.len();
            events.retain(|event| !matches!(event, DeviceEvent::Telemetry(_)));
            let dropped = (before - events.len()) as u32;
            self.events_dropped = self.events_dropped.wrapping_add(dropped);
        }
        if self.receiver.events.len() < MAX_EVENTS / 2 {
            self.receive(timeout)?;
        } else {
            std::thread::sleep(timeout);
        }
        Ok(())
    }

    /// Counts an event dropped by the caller.
    #[cfg(feature = "async")]
    pub(crate) fn count_dropped_event(&mut self) {
        self.events_dropped = self.events_dropped.wrapping_add(1);
    }

    /// Sends a message, `tries` times within the time-out, until the awaited response comes.
    fn exchange<'s, M: Message, A: Message + Deserialize<'s>>(
        &'s mut self,
        message: &M,
        awaited: AwaitedResponse,
        tries: u32,
    ) -> Result<A, LinkError> {
        // Faults of the link seen so far do not explain a missing answer to this one.
        let before = self.receiver.counters();
        self.off_preemption.off_sent = false;
        self.answer = None;
        self.awaited = Some(awaited);
        let came = self.send_until_answered(message, awaited.number, tries);
        // A later response is stray.
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
        answer.ok_or_else(|| match self.off_preemption.off_sent {
            true => LinkError::Preempted { command: M::NAME },
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
                if let Some(grace) = self.preempt(M::ID)? {
                    deadline = deadline.min(now + grace);
                }
                let left = deadline.saturating_sub(now);
                let slice = left.min(self.off_preemption.poll_period());
                if left.is_zero() || (self.receive(slice)? == 0 && slice == left) {
                    break;
                }
            }
            if self.answer.is_some() || self.off_preemption.off_sent {
                break;
            }
        }
        Ok(())
    }

    /// Sends `SetPower(0)` if a request to switch off is waiting. Returns how long the command `id` then still waits for its
    /// response; `None` if it is not preempted.
    fn preempt(&mut self, id: u8) -> Result<Option<Duration>, LinkError> {
        if self.off_preemption.off_sent || !self.off_preemption.is_requested() {
            return Ok(None);
        }
        self.off_preemption.off_sent = true;
        self.number = self.number.next();
        self.send(&SetPower { power_w: 0 }, self.number)?;
        // A request for power is dropped at once.
        Ok(Some(match id {
            SetPower::ID => Duration::ZERO,
            _ => PREEMPTED_WAIT,
        }))
    }

    fn no_answer(&self, command: &'static str, before: &ClientCounters) -> LinkError {
        let now = self.receiver.counters();
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

    /// Receives for `timeout` and requests missing pieces of windows meanwhile; returns the number of bytes received.
    pub(super) fn receive(&mut self, timeout: Duration) -> Result<usize, LinkError> {
        let start = self.transport.clock();
        loop {
            let pause = self.ask_for_pieces()?;
            let now = self.transport.clock();
            let left = timeout.saturating_sub(now.saturating_sub(start));
            let length = self.read(left.min(pause))?;
            if length > 0 || left <= pause {
                // Requested now rather than with the next call, which may be late.
                self.ask_for_pieces()?;
                return Ok(length);
            }
        }
    }

    /// Receives for `timeout`; returns the number of bytes.
    fn read(&mut self, timeout: Duration) -> Result<usize, LinkError> {
        let mut buf = [0; 16 * 1024];
        let length = self.transport.receive(&mut buf, timeout)?;
        let bytes = &buf[..length];
        let known = self.receiver.events.len();
        let now = self.transport.clock();
        self.receiver.take(bytes, self.awaited.is_some(), now);
        self.tap.take(now, bytes);
        self.take_answers();
        self.release_windows(known)?;
        self.limit_events();
        Ok(length)
    }

    /// Picks the awaited response; all others are counted as stray.
    fn take_answers(&mut self) {
        while let Some(answer) = self.receiver.answers.pop_front() {
            if self.awaited.is_some_and(|awaited| awaited.is(&answer)) {
                self.answer = Some(answer);
                self.awaited = None;
            } else {
                self.answers_stray = self.answers_stray.wrapping_add(1);
            }
        }
    }

    /// Limits the queue of events: drops telemetry first, then the oldest.
    fn limit_events(&mut self) {
        let events = &mut self.receiver.events;
        let excess = events.len().saturating_sub(MAX_EVENTS);
        if excess == 0 {
            return;
        }
        let mut left = excess;
        events.retain(|event| {
            let goes = left > 0 && matches!(event, DeviceEvent::Telemetry(_));
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

    /// Resets the counts of the link test.
    pub(super) fn forget_link_data(&mut self) {
        self.receiver.link_data = LinkTestCounts::NONE;
    }

    /// Counts of the link test.
    pub(super) fn link_data(&self) -> LinkTestCounts {
        self.receiver.link_data
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

mod commands;
mod pieces;

#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod pairing_tests;
