//! Housekeeping, once a block in the thread: commands from the link, control, telemetry, the active lookup.

use ihd_shared::fault::Fault;
use ihd_shared::hob::{RATED_POWER_W, REQUESTED_POWER_MAX_W};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_REPLAYING, check};
use ihd_shared::wire::messages::{
    AnyMessage, Configure, DecodeError, FaultEvent, Hello, Message, Outcome, Program, ReplayMode,
    ReplayStart, ResendWindow, State, Status, Stream, TestLink, is_numbered,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;

use crate::control::controller::Control;
use crate::control::request::PanelEvent;
use crate::control::status::{Action, SamplingStatus};
use crate::control::temperature::TemperatureCodes;
use crate::link::active_lookup::ActiveLookup;
use crate::link::conversation::{Conversation, RequestOrder};
use crate::link::identity::DeviceIdentity;
use crate::link::log_ring::LogSource;
use crate::link::replay::Replay;
use crate::link::report;
use crate::link::response::Response;
use crate::link::service::{BoardServices, BoardTest, Service};
use crate::link::transmit_queue::TransmitQueue;
use crate::retained::control::RetainedControl;
use crate::sampling::half_cycle::HalfCycle;
use crate::sampling::path::{SamplingLock, SamplingPath};
use crate::sense::supply::{Reference, SupplyScale};

/// The link's incoming side, control and lookup.
pub struct Housekeeping {
    deframer: Deframer,
    conversation: Conversation,
    queue: TransmitQueue,
    control: Control,
    service: Service,
    paired: bool,
    telemetry_every: u8,
    lookup: ActiveLookup,
    settings: Configure,
    reported_fault: Fault,
    half_cycles_unheard: u32,
    last: HalfCycle,
    replay: Replay,
}

impl Housekeeping {
    /// Starts with the built-in prior as lookup; `hello` describes the device.
    pub fn new(hello: Hello) -> Self {
        Self {
            deframer: Deframer::new(),
            conversation: Conversation::default(),
            queue: TransmitQueue::new(hello),
            control: Control::default(),
            service: Service::default(),
            paired: false,
            telemetry_every: 0,
            lookup: ActiveLookup::default(),
            settings: Configure::DEFAULT,
            reported_fault: Fault::NONE,
            half_cycles_unheard: 0,
            last: HalfCycle::default(),
            replay: Replay::default(),
        }
    }

    /// Starts from a lookup that was kept, in place of the prior ([`ActiveLookup::restore`]).
    pub fn restore(&mut self, lookup: RlLookup) {
        self.lookup.restore(lookup);
    }

    /// Goes on with what control kept through a reset; `fault` was active then, and is again if it has locked out.
    pub fn restore_control(
        &mut self,
        lock: &mut impl SamplingLock,
        kept: RetainedControl,
        fault: Fault,
    ) {
        let status = lock.with(|rt| {
            if kept.locked_out {
                rt.raise(fault);
            }
            SamplingStatus::read(rt)
        });
        self.control.restore(kept, &status);
    }

    /// Sets the identity of the device, before a host connects.
    pub fn set_identity(&mut self, identity: DeviceIdentity) {
        self.queue.set_identity(identity);
    }

    /// Sets the place where the log is kept until it is sent.
    pub fn set_log(&mut self, log: &'static dyn LogSource) {
        self.queue.set_log(log);
    }

    /// Returns `true` if the lookup in use is still what it was when it became that (a self-test).
    pub fn is_lookup_intact(&self) -> bool {
        self.lookup.is_intact()
    }

    /// The lookup in use.
    pub fn lookup(&self) -> &RlLookup {
        &self.lookup
    }

    /// The last half-cycle's summary.
    pub fn summary(&self) -> &HalfCycle {
        &self.last
    }

    /// Number of times that another lookup became active since boot, so that the board keeps it in flash. Its version may return after a
    /// reset.
    pub fn lookup_changes(&self) -> u32 {
        self.lookup.changes()
    }

    /// Settings of a host, else [`Configure::DEFAULT`].
    pub fn settings(&self) -> &Configure {
        &self.settings
    }

    /// The state machine.
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// Takes bytes from the link; returns how many. Fewer than given means that responses wait for
    /// the link: offer the rest again later.
    #[inline(never)]
    pub fn receive(&mut self, lock: &mut impl SamplingLock, bytes: &[u8]) -> usize {
        for (taken, &byte) in bytes.iter().enumerate() {
            if self.queue.is_full() {
                return taken;
            }
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let id = frame.id;
            // A host sends it by itself for as long as windows come: it keeps no power up.
            if id != ResendWindow::ID {
                self.half_cycles_unheard = 0;
            }
            let (number, bytes) = frame.split();
            if self.paired
                && is_numbered(id)
                && !is_new_request(&mut self.conversation, &mut self.queue, number)
            {
                continue;
            }
            let response = match AnyMessage::decode(id, bytes) {
                // These three borrow from the deframer; the rest may borrow all of self.
                Ok(AnyMessage::PushLookup(push)) if self.paired => {
                    let offered = RlLookup::from_bytes(push.blob.0);
                    let (outcome, detail) = match offered {
                        Ok(lookup) => self.lookup.accept(lookup),
                        Err(why) => why.outcome(),
                    };
                    Some(Response::reply(outcome, detail))
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
                Ok(AnyMessage::TestChannels(_)) => self.begin_test(number, BoardTest::Channels),
                Ok(AnyMessage::TestComparators(_)) => {
                    self.begin_test(number, BoardTest::Comparators)
                }
                Ok(AnyMessage::TestClocks(_)) => self.begin_test(number, BoardTest::Clocks),
                Ok(AnyMessage::Restart(m)) => self.begin_restart(number, m.into),
                Ok(AnyMessage::SetPower(m)) => {
                    let (outcome, detail) = self.host_power(lock, m.power_w);
                    Some(Response::reply(outcome, detail))
                }
                Ok(AnyMessage::Stream(m)) => Some(self.stream(lock, &m)),
                Ok(AnyMessage::GetStatus(_)) => Some(Response::Status(self.status(lock))),
                Ok(AnyMessage::ReadLookup(_)) => Some(Response::Lookup),
                Ok(AnyMessage::ResetLookup(_)) => {
                    let (outcome, detail) = self.lookup.replace(prior());
                    Some(Response::reply(outcome, detail))
                }
                Ok(AnyMessage::Configure(m)) => Some(self.configure(lock, m)),
                Ok(AnyMessage::GetFrontEnd(_)) => Some(Response::FrontEnd),
                Ok(AnyMessage::ClearFault(_)) => Some(self.clear_fault(lock)),
                Ok(AnyMessage::GetUtilisation(_)) => {
                    Some(Response::Utilisation(lock.with(report::utilisation)))
                }
                Ok(AnyMessage::ReplayStart(m)) => Some(self.start_replay(lock, &m)),
                Ok(AnyMessage::ReplayEnd(_)) => {
                    let mode = self.replay.end(lock);
                    Some(self.replay_mode(mode))
                }
                Ok(AnyMessage::GetBoard(_)) => Some(Response::Board),
                Ok(AnyMessage::TestLink(m)) => Some(self.test_link(&m)),
                Ok(AnyMessage::StreamLog(m)) => Some(match self.queue.stream_log(m.on) {
                    true => Response::outcome(Outcome::Ok),
                    false => Response::outcome(Outcome::Unavailable),
                }),
                Ok(_) | Err(DecodeError::UnknownId { .. }) => {
                    Some(Response::outcome(Outcome::UnknownMessage))
                }
                Err(DecodeError::Malformed { .. } | DecodeError::Trailing { .. }) => {
                    Some(Response::outcome(Outcome::Malformed))
                }
            };
            if let Some(response) = response {
                self.respond(number, response);
            }
        }
        bytes.len()
    }

    /// Responds to a request, now and when it comes again.
    fn respond(&mut self, number: Number, response: Response) {
        self.conversation.keep(number, &response);
        self.queue.respond(number, response);
    }

    /// Pairs with a host that sends its hello: it starts from a silent device that heats for no host.
    fn pair(&mut self, lock: &mut impl SamplingLock, theirs: &Hello) {
        self.end_host_power(lock);
        let fits = check(self.queue.hello(), theirs).is_ok();
        self.paired = fits && !self.service.is_leaving();
        self.conversation = Conversation::default();
        self.queue.restart(lock);
        self.service.forget(lock);
        self.telemetry_every = 0;
        // A new host must learn of an active fault, even if it was reported to another before.
        self.reported_fault = Fault::NONE;
        lock.with(|rt| rt.recorder().set_period(0));
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

    fn test_link(&mut self, test: &TestLink) -> Response {
        if usize::from(test.bytes) > CHUNK_BYTES {
            return Response::reply(Outcome::OutOfRange, 1);
        }
        let tested = self.service.take_link_counts();
        self.queue.send_link_data(test.frames, test.bytes);
        Response::LinkTested(tested)
    }

    /// To be called after each block, behind [`Housekeeping::poll`]: carries out what a host has requested of the board,
    /// a step at a time.
    #[inline(never)]
    pub fn serve(&mut self, lock: &mut impl SamplingLock, board: &mut impl BoardServices) {
        // A full queue would lose the response.
        if self.queue.is_full() {
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

    /// Takes a host's request of power, at most the rating; the detail of [`Outcome::Ok`] is the power that was taken.
    fn host_power(&mut self, lock: &mut impl SamplingLock, power_w: u16) -> (Outcome, u32) {
        let (fault, replaying) = lock.with(|rt| (rt.fault(), rt.is_replaying()));
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

    /// A person touches the panel.
    pub fn panel(&mut self, lock: &mut impl SamplingLock, event: PanelEvent) {
        if self.service.is_leaving() {
            return;
        }
        let action = self.control.panel(event);
        self.act(lock, action);
    }

    /// Lets minutes pass at once for the times of cooking, on a simulated hob.
    pub fn pass_minutes(&mut self, lock: &mut impl SamplingLock, minutes: u16) {
        let action = self.control.pass_minutes(minutes);
        self.act(lock, action);
    }

    /// A reading of the chip's reference voltage, some hundred times a second; returns the correction of every reading from
    /// now on.
    pub fn set_reference(&mut self, reference: Reference) -> SupplyScale {
        self.control.set_reference(reference);
        self.control.supply_scale()
    }

    /// Codes of the temperature sensors, some hundred times a second.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.control.set_temperatures(codes);
    }

    /// Returns `true` if the fan is to run.
    pub fn fan(&self) -> bool {
        self.control.temperatures().fan()
    }

    fn clear_fault(&mut self, lock: &mut impl SamplingLock) -> Response {
        let action = self.control.clear_fault();
        self.act(lock, action);
        let standing = lock.with(|rt| rt.fault());
        let outcome = match standing {
            Fault::NONE => Outcome::Ok,
            _ if self.control.state() == State::LockedOut => Outcome::LockedOut,
            _ => Outcome::FaultActive,
        };
        Response::reply(outcome, u32::from(standing.number()))
    }

    fn start_replay(&mut self, lock: &mut impl SamplingLock, m: &ReplayStart) -> Response {
        let off = self.control.switch_off();
        self.act(lock, off);
        match self.replay.start(lock, m) {
            Ok(mode) => self.replay_mode(mode),
            Err((outcome, detail)) => Response::reply(outcome, detail),
        }
    }

    fn replay_mode(&mut self, mode: ReplayMode) -> Response {
        self.queue.set_capability(CAP_REPLAYING, mode.active);
        Response::ReplayMode(mode)
    }

    fn stream(&mut self, lock: &mut impl SamplingLock, m: &Stream) -> Response {
        self.telemetry_every = m.telemetry_every;
        lock.with(|rt| rt.recorder().set_period(m.windows_every));
        Response::outcome(Outcome::Ok)
    }

    fn configure(&mut self, lock: &mut impl SamplingLock, settings: Configure) -> Response {
        match settings.check() {
            Ok(()) => {
                self.control.set_give_up_s(settings.give_up_s);
                lock.with(|rt| rt.set_dither(settings.dither_permille));
                self.settings = settings;
                Response::outcome(Outcome::Ok)
            }
            Err(field) => Response::reply(Outcome::OutOfRange, field),
        }
    }

    /// To be called after each block: control, telemetry, faults. One step of the search for a
    /// frequency is the longest it does.
    #[inline(never)]
    pub fn poll(&mut self, lock: &mut impl SamplingLock) {
        let (sums, status) = lock.with(|rt| {
            rt.housekeeping_gap().end();
            (rt.take_half_cycle(), SamplingStatus::read(rt))
        });
        let action = match sums.map(|half_cycle| half_cycle.evaluate()) {
            Some(probe) if probe.is_pot_probe => self.control.on_half_cycle(&probe, &status),
            Some(summary) => self.on_half_cycle(lock, &summary, &status),
            None => self.control.advance(&self.lookup, &status),
        };
        self.act(lock, action);
        // The request that was just made counts.
        let status = lock.with(|rt| SamplingStatus::read(rt));
        let action = self.control.tick(&status);
        self.act(lock, action);
        let (fault, half_cycle) = lock.with(|rt| (rt.fault(), rt.fault_half_cycle()));
        if fault != self.reported_fault && self.paired && !self.queue.is_full() {
            self.reported_fault = fault;
            self.queue
                .announce(Response::Fault(FaultEvent { half_cycle, fault }));
        }
    }

    #[inline(never)]
    fn on_half_cycle(
        &mut self,
        lock: &mut impl SamplingLock,
        summary: &HalfCycle,
        status: &SamplingStatus,
    ) -> Action {
        if let Some(version) = self.lookup.on_half_cycle() {
            lock.with(|rt| rt.recorder().set_lookup_version(version));
        }
        self.watch_host(lock);
        self.queue.on_half_cycle(lock);
        self.last = *summary;
        let action = self.control.on_half_cycle(summary, status);
        self.send_telemetry(lock, summary);
        action
    }

    /// Power that was requested over the link lapses with the link.
    fn watch_host(&mut self, lock: &mut impl SamplingLock) {
        self.half_cycles_unheard = self.half_cycles_unheard.saturating_add(1);
        if self.half_cycles_unheard >= HOST_UNHEARD_HALF_CYCLES {
            self.end_host_power(lock);
        }
    }

    fn end_host_power(&mut self, lock: &mut impl SamplingLock) {
        if self.control.request().is_of_host() {
            let action = self.control.host_lost();
            self.act(lock, action);
        }
    }

    fn act(&mut self, lock: &mut impl SamplingLock, action: Action) {
        match action {
            Action::Keep => {}
            Action::Drive(drive) => lock.with(|rt| rt.request(drive)),
            Action::ProbePot => lock.with(SamplingPath::request_pot_probe),
            Action::OffAtCrossing => lock.with(SamplingPath::request_off_at_crossing),
            Action::Fault(fault) => lock.with(|rt| rt.raise(fault)),
            Action::ClearFault => lock.with(SamplingPath::clear_fault),
        }
    }

    #[inline(never)]
    fn send_telemetry(&mut self, lock: &mut impl SamplingLock, s: &HalfCycle) {
        let every = u32::from(self.telemetry_every);
        if !self.paired || every == 0 || !s.half_cycle.is_multiple_of(every) {
            return;
        }
        let fault = lock.with(|rt| rt.fault());
        let (control, version) = (&self.control, self.lookup.version);
        self.queue
            .telemetry(|seq, dropped| report::telemetry(seq, dropped, s, fault, control, version));
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

    /// Writes the next frame for the link, if there is one; returns its length, 0 for none.
    pub fn transmit(&mut self, lock: &mut impl SamplingLock, out: &mut [u8; MAX_ENCODED]) -> usize {
        self.queue.transmit(lock, &self.lookup, out)
    }
}

/// Returns `true` if a request of this number is to be carried out. One that comes again gets its response again.
fn is_new_request(
    conversation: &mut Conversation,
    queue: &mut TransmitQueue,
    number: Number,
) -> bool {
    match conversation.turn(number) {
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
