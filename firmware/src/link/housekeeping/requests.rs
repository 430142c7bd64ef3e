//! Frames from the host: what they request, and the responses.

use ihd_shared::fault::Fault;
use ihd_shared::hob::{RATED_POWER_W, REQUESTED_POWER_MAX_W};
use ihd_shared::lookup::prior::prior;
use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::hello::{CAP_REPLAYING, ROLE_HOST, check};
use ihd_shared::wire::messages::{
    AnyMessage, ClearFault, Configure, DecodeError, GetBoard, GetFrontEnd, GetStatus,
    GetUtilisation, Hello, Message, Outcome, Program, ReadLookup, ReplayEnd, ReplayMode,
    ReplayStart, ResetLookup, State, Status, Stream, TestChannels, TestClocks, TestComparators,
    TestLink, is_numbered, is_request,
};
use ihd_shared::wire::number::Number;

use crate::link::conversation::{Conversation, RequestOrder};
use crate::link::housekeeping::Housekeeping;
use crate::link::report;
use crate::link::response::Response;
use crate::link::service::{BoardServices, BoardTest};
use crate::link::transmit_queue::TransmitQueue;
use crate::sampling::path::SamplingLock;

/// Frames, requests that the board carries out, and the conversation.
impl Housekeeping {
    /// Takes bytes from the link, all of them whatever waits to be sent: a host that does not read is still obeyed.
    #[inline(never)]
    pub fn receive(&mut self, lock: &mut impl SamplingLock, bytes: &[u8]) {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let id = frame.id;
            let (number, bytes) = frame.split();
            if self.paired && is_numbered(id) {
                let order = self.conversation.turn(number);
                // Nothing else keeps power up: not what a host sends by itself for as long as windows come, and no echo of
                // the device's own frames, which have the request's number.
                if is_request(id) && matches!(order, RequestOrder::New | RequestOrder::Again) {
                    self.heard_ms = lock.with(|path| path.now_ms());
                }
                if !is_new_request(order, &self.conversation, &mut self.queue, number) {
                    continue;
                }
            }
            let response = match AnyMessage::decode(id, bytes) {
                // These three borrow from the deframer; the rest may borrow all of self.
                Ok(AnyMessage::PushLookup(push)) if self.paired => {
                    Some(self.lookup.push(push.blob.0).into())
                }
                Ok(AnyMessage::ReplayBlocks(blocks)) if self.paired => {
                    let replayed = self.replay.blocks(lock, &blocks);
                    Some(replayed.map_or_else(Response::outcome, Response::ReplayEstimates))
                }
                Ok(AnyMessage::LinkData(data)) if self.paired => {
                    self.service.take_link_data(&data);
                    None
                }
                Ok(AnyMessage::ResendWindow(m)) if self.paired => {
                    self.queue.resend(lock, m);
                    None
                }
                Ok(AnyMessage::Hello(theirs)) => {
                    self.pair(lock, &theirs);
                    None
                }
                _ if !is_numbered(id) => None,
                _ if !self.paired => Some(Response::outcome(Outcome::NotPaired)),
                Ok(AnyMessage::Restart(m)) => self.begin_restart(number, m.into),
                Ok(AnyMessage::SetPower(m)) => Some(self.host_power(lock, m.power_w).into()),
                Ok(AnyMessage::Stream(m)) => Some(self.stream(lock, &m)),
                Ok(AnyMessage::Configure(m)) => Some(self.configure(lock, m)),
                Ok(AnyMessage::ReplayStart(m)) => Some(self.start_replay(lock, &m)),
                Ok(AnyMessage::TestLink(m)) => Some(self.test_link(&m)),
                Ok(AnyMessage::StreamLog(m)) => Some(self.stream_log(m.on)),
                Ok(_) => self.request_without_fields(lock, number, id),
                Err(why) => Some(Response::outcome(outcome_of(&why))),
            };
            if let Some(response) = response {
                self.respond(number, response);
            }
        }
    }

    /// Carries out a request without fields by its id: the message itself borrows from the deframer.
    fn request_without_fields(
        &mut self,
        lock: &mut impl SamplingLock,
        number: Number,
        id: u8,
    ) -> Option<Response> {
        Some(match id {
            TestChannels::ID => return self.begin_test(number, BoardTest::Channels),
            TestComparators::ID => return self.begin_test(number, BoardTest::Comparators),
            TestClocks::ID => return self.begin_test(number, BoardTest::Clocks),
            GetStatus::ID => Response::Status(self.status(lock)),
            ReadLookup::ID => Response::Lookup,
            ResetLookup::ID => self.lookup.replace(prior()).into(),
            GetFrontEnd::ID => Response::FrontEnd,
            ClearFault::ID => self.clear_fault(lock),
            GetUtilisation::ID => Response::Utilisation(lock.with(report::utilisation)),
            ReplayEnd::ID => self.end_replay(lock),
            GetBoard::ID => Response::Board,
            _ => Response::outcome(Outcome::UnknownMessage),
        })
    }

    /// Responds to a request, now and when it comes again.
    fn respond(&mut self, number: Number, response: Response) {
        self.conversation.keep(number, &response);
        self.queue.respond(number, response);
    }

    /// Pairs with a host that sends its hello: it starts from a silent device that heats for no host.
    fn pair(&mut self, lock: &mut impl SamplingLock, theirs: &Hello) {
        if theirs.role == ROLE_HOST {
            self.heard_ms = lock.with(|path| path.now_ms());
        }
        self.end_host_power(lock);
        let fits = check(self.queue.hello(), theirs).is_ok();
        self.paired = fits && !self.service.is_leaving();
        self.conversation = Conversation::default();
        self.queue.restart(lock);
        self.service.forget(lock);
        self.telemetry_every = 0;
        // A new host must learn of an active fault, even if it was reported to another before.
        self.reported_fault = Fault::NONE;
        lock.with(|path| path.recorder().set_period(0));
        // One that does not fit sees it in ours.
        self.queue.announce(Response::Hello);
    }

    /// Ends the conversation until the next hello.
    fn unpair(&mut self) {
        self.paired = false;
        self.telemetry_every = 0;
    }

    /// Begins a test of the board, which is responded to later, or responds that something else is under way.
    fn begin_test(&mut self, number: Number, test: BoardTest) -> Option<Response> {
        let begun = self.service.begin_test(number, test);
        (!begun).then_some(Response::outcome(Outcome::Busy))
    }

    /// Begins a restart in the same way.
    fn begin_restart(&mut self, number: Number, into: Program) -> Option<Response> {
        let begun = self.service.begin_restart(number, into);
        (!begun).then_some(Response::outcome(Outcome::Busy))
    }

    /// Carries out what a host has requested of the board, a step at a time; to be called after each block, behind
    /// [`Housekeeping::poll`].
    #[inline(never)]
    pub fn serve(&mut self, lock: &mut impl SamplingLock, board: &mut impl BoardServices) {
        // A full queue would lose the response; a restart under way has given its own.
        if self.queue.is_full() && !self.service.is_leaving() {
            return;
        }
        let idle = self.control.asked_w() == 0 || self.control.state() == State::LockedOut;
        let Some((number, response)) = self.service.poll(idle, lock, board) else {
            return;
        };
        self.respond(number, response);
        if self.service.is_leaving() {
            self.unpair();
        }
    }
}

/// Requests by their message.
impl Housekeeping {
    /// Takes a host's request of power, at most the rating; the detail of [`Outcome::Ok`] is the power that was taken.
    fn host_power(&mut self, lock: &mut impl SamplingLock, power_w: u16) -> (Outcome, u32) {
        let (fault, replaying) = lock.with(|path| (path.fault(), path.is_replaying()));
        if power_w > REQUESTED_POWER_MAX_W {
            return (Outcome::PowerOutOfRange, u32::from(REQUESTED_POWER_MAX_W));
        }
        let power_w = power_w.min(RATED_POWER_W);
        if power_w > 0 && replaying {
            // Nothing may be heated; there is no fault to name.
            return (Outcome::FaultActive, 0);
        }
        if power_w > 0 && self.control.state() == State::LockedOut {
            return (Outcome::LockedOut, u32::from(fault.number()));
        }
        match self.control.host(power_w) {
            Some(action) => {
                self.act(lock, action);
                (Outcome::Ok, u32::from(power_w))
            }
            None => (Outcome::PanelOff, 0),
        }
    }

    fn clear_fault(&mut self, lock: &mut impl SamplingLock) -> Response {
        let action = self.control.clear_fault();
        self.act(lock, action);
        let standing = lock.with(|path| path.fault());
        let outcome = match standing {
            Fault::NONE => Outcome::Ok,
            _ if self.control.state() == State::LockedOut => Outcome::LockedOut,
            _ => Outcome::FaultActive,
        };
        Response::reply(outcome, u32::from(standing.number()))
    }

    fn start_replay(&mut self, lock: &mut impl SamplingLock, m: &ReplayStart) -> Response {
        let power_is_requested = self.control.asked_w() > 0;
        match self.replay.start(lock, m, power_is_requested) {
            Ok(mode) => self.replay_mode(mode),
            Err((outcome, detail)) => Response::reply(outcome, detail),
        }
    }

    pub(super) fn end_replay(&mut self, lock: &mut impl SamplingLock) -> Response {
        let mode = self.replay.end(lock);
        self.replay_mode(mode)
    }

    fn replay_mode(&mut self, mode: ReplayMode) -> Response {
        self.queue.set_capability(CAP_REPLAYING, mode.active);
        Response::ReplayMode(mode)
    }

    fn stream(&mut self, lock: &mut impl SamplingLock, m: &Stream) -> Response {
        self.telemetry_every = m.telemetry_every;
        lock.with(|path| path.recorder().set_period(m.windows_every));
        Response::outcome(Outcome::Ok)
    }

    fn stream_log(&mut self, on: bool) -> Response {
        Response::outcome(match self.queue.stream_log(on) {
            true => Outcome::Ok,
            false => Outcome::Unavailable,
        })
    }

    fn configure(&mut self, lock: &mut impl SamplingLock, settings: Configure) -> Response {
        match settings.check() {
            Ok(()) => {
                self.control.set_give_up_s(settings.give_up_s);
                lock.with(|path| path.set_dither(settings.dither_permille));
                self.settings = settings;
                Response::outcome(Outcome::Ok)
            }
            Err(field) => Response::reply(Outcome::OutOfRange, field),
        }
    }

    fn test_link(&mut self, test: &TestLink) -> Response {
        if usize::from(test.bytes) > CHUNK_BYTES {
            return Response::reply(Outcome::OutOfRange, 1);
        }
        let tested = self.service.take_link_counts();
        self.queue.send_link_data(test.frames, test.bytes);
        Response::LinkTested(tested)
    }

    #[inline(never)]
    fn status(&mut self, lock: &mut impl SamplingLock) -> Status {
        let received = self.deframer.counters();
        let telemetry_dropped = self.queue.telemetry_dropped();
        let (control, version, last) = (&self.control, self.lookup.version, &self.last);
        lock.with(|path| Status {
            telemetry_dropped,
            frames_bad: received.bad,
            frames_lost: received.lost,
            ..report::status(path, control, last, version)
        })
    }
}

fn outcome_of(why: &DecodeError) -> Outcome {
    match why {
        DecodeError::UnknownId { .. } => Outcome::UnknownMessage,
        DecodeError::Malformed { .. } | DecodeError::Trailing { .. } => Outcome::Malformed,
    }
}

/// Returns `true` if a request of this number is to be carried out. One that comes again gets its response again.
fn is_new_request(
    order: RequestOrder,
    conversation: &Conversation,
    queue: &mut TransmitQueue,
    number: Number,
) -> bool {
    match order {
        RequestOrder::New => return true,
        RequestOrder::Again => {
            if let Some(response) = conversation.response() {
                queue.respond(number, response.clone());
            }
        }
        RequestOrder::Past => {}
        RequestOrder::Unnumbered => {
            queue.respond(number, Response::outcome(Outcome::Malformed));
        }
    }
    false
}
