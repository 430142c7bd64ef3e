//! Work below the sampling path: commands from the link, power control, the active lookup.

use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_REPLAYING, check};
use ihd_shared::wire::messages::{
    AnyMessage, Configure, DecodeError, FaultEvent, Hello, Message, NO_PANEL, NO_SENSOR_C, Outcome,
    ReplayMode, ReplayStart, Reply, ResendWindow, State, Status, Stream, Telemetry, Utilisation,
    is_numbered,
};
use ihd_shared::wire::number::Number;
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;

use crate::control::{Action, Control, Now};
use crate::conversation::{Conversation, Turn};
use crate::half_cycle::Summary;
use crate::impedance::Tank;
use crate::realtime::{Access, RealTime};
use crate::replay::Replay;
use crate::request::PanelEvent;
use crate::self_test::guarded::GuardedLookup;
use crate::service::{Service, Test};
use crate::temperature::TemperatureCodes;
use crate::transmit_queue::{Answer, TransmitQueue};

/// The link's incoming side, control and lookup.
pub struct Housekeeping {
    deframer: Deframer,
    conversation: Conversation,
    pub(crate) queue: TransmitQueue,
    control: Control,
    pub(crate) service: Service,
    paired: bool,
    telemetry_every: u8,
    active: GuardedLookup,
    pending: Option<RlLookup>,
    /// Lookups that became active since boot.
    lookup_changes: u32,
    settings: Configure,
    reported_fault: Fault,
    half_cycles_unheard: u32,
    last: Summary,
    replay: Replay,
}

impl Housekeeping {
    /// With the built-in prior as lookup; `hello` is what the device says of itself.
    pub fn new(hello: Hello) -> Self {
        Self {
            deframer: Deframer::new(),
            conversation: Conversation::default(),
            queue: TransmitQueue::new(hello),
            control: Control::default(),
            service: Service::default(),
            paired: false,
            telemetry_every: 0,
            active: GuardedLookup::new(prior()),
            pending: None,
            lookup_changes: 0,
            settings: Configure::DEFAULT,
            reported_fault: Fault::NONE,
            half_cycles_unheard: 0,
            last: Summary::default(),
            replay: Replay::default(),
        }
    }

    /// Starts from a lookup that was kept, in place of the prior. One of version 0 says that it was
    /// reset: this build's prior stays, which may be a newer one.
    pub fn restore(&mut self, lookup: RlLookup) {
        if lookup.version > 0 {
            self.active = GuardedLookup::new(lookup);
        }
    }

    /// Returns `true` if the lookup in use is still what it was when it became that (a self-test).
    pub fn is_lookup_intact(&self) -> bool {
        self.active.is_intact()
    }

    /// The lookup in use.
    pub fn lookup(&self) -> &RlLookup {
        &self.active
    }

    /// The last half-cycle's summary.
    pub fn summary(&self) -> &Summary {
        &self.last
    }

    /// Number of times that another lookup became active since boot, for whoever keeps it. Its version may return after a
    /// reset.
    pub fn lookup_changes(&self) -> u32 {
        self.lookup_changes
    }

    /// Settings of a host, else [`Configure::DEFAULT`].
    pub fn settings(&self) -> &Configure {
        &self.settings
    }

    /// The state machine.
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// Takes bytes from the link; returns how many. Fewer than given means that answers wait for
    /// the link: offer the rest again later.
    #[inline(never)]
    pub fn receive(&mut self, access: &mut impl Access, bytes: &[u8]) -> usize {
        for (taken, &byte) in bytes.iter().enumerate() {
            if self.queue.is_full() {
                return taken;
            }
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let id = frame.id;
            // A host sends it by itself for as long as windows come: it answers for no power.
            if id != ResendWindow::ID {
                self.half_cycles_unheard = 0;
            }
            let (number, bytes) = frame.split();
            if self.paired && is_numbered(id) {
                match self.conversation.turn(number) {
                    Turn::New => {}
                    Turn::Again => {
                        if let Some(answer) = self.conversation.answer() {
                            self.queue.answer(number, answer.clone());
                        }
                        continue;
                    }
                    Turn::Past => continue,
                    Turn::Unnumbered => {
                        self.queue.answer(number, outcome(Outcome::Malformed));
                        continue;
                    }
                }
            }
            let answer = match AnyMessage::decode(id, bytes) {
                // These three borrow from the deframer; the rest may borrow all of self.
                Ok(AnyMessage::PushLookup(push)) if self.paired => {
                    let offered = RlLookup::from_bytes(push.blob.0);
                    let (outcome, detail) = match offered {
                        Ok(lookup) => self.accept(lookup),
                        Err(why) => why.outcome(),
                    };
                    Some(reply(outcome, detail))
                }
                Ok(AnyMessage::ReplayBlocks(blocks)) if self.paired => {
                    let replayed = self.replay.blocks(access, &blocks);
                    Some(replayed.map_or_else(outcome, Answer::ReplayEstimates))
                }
                Ok(AnyMessage::LinkData(data)) if self.paired => {
                    self.service.take_link_data(&data);
                    None
                }
                Ok(AnyMessage::ResendWindow(m)) if self.paired => {
                    self.queue.resend(access, m);
                    None
                }
                Ok(AnyMessage::Hello(theirs)) => {
                    self.pair(access, &theirs);
                    None
                }
                _ if !is_numbered(id) => None,
                _ if !self.paired => Some(outcome(Outcome::NotPaired)),
                Ok(AnyMessage::TestChannels(_)) => self.ask_test(number, Test::Channels),
                Ok(AnyMessage::TestComparators(_)) => self.ask_test(number, Test::Comparators),
                Ok(AnyMessage::TestClocks(_)) => self.ask_test(number, Test::Clocks),
                Ok(AnyMessage::Restart(m)) => self.ask_restart(number, m.into),
                Ok(AnyMessage::SetPower(m)) => {
                    let (outcome, detail) = self.host_power(access, m.power_w);
                    Some(reply(outcome, detail))
                }
                Ok(AnyMessage::Stream(m)) => Some(self.stream(access, &m)),
                Ok(AnyMessage::GetStatus(_)) => Some(Answer::Status(self.status(access))),
                Ok(AnyMessage::ReadLookup(_)) => Some(Answer::Lookup),
                Ok(AnyMessage::ResetLookup(_)) => {
                    let (outcome, detail) = self.activate(prior());
                    Some(reply(outcome, detail))
                }
                Ok(AnyMessage::Configure(m)) => Some(self.configure(access, m)),
                Ok(AnyMessage::GetFrontEnd(_)) => Some(Answer::FrontEnd),
                Ok(AnyMessage::ClearFault(_)) => Some(self.clear_fault(access)),
                Ok(AnyMessage::GetUtilisation(_)) => {
                    Some(Answer::Utilisation(access.with(utilisation)))
                }
                Ok(AnyMessage::ReplayStart(m)) => Some(self.start_replay(access, &m)),
                Ok(AnyMessage::ReplayEnd(_)) => {
                    let mode = self.replay.end(access);
                    Some(self.replay_mode(mode))
                }
                Ok(AnyMessage::GetBoard(_)) => Some(Answer::Board),
                Ok(AnyMessage::TestLink(m)) => Some(self.test_link(&m)),
                Ok(AnyMessage::StreamLog(m)) => Some(match self.queue.stream_log(m.on) {
                    true => outcome(Outcome::Ok),
                    false => outcome(Outcome::Unavailable),
                }),
                Ok(_) | Err(DecodeError::UnknownId { .. }) => {
                    Some(outcome(Outcome::UnknownMessage))
                }
                Err(DecodeError::Malformed { .. } | DecodeError::Trailing { .. }) => {
                    Some(outcome(Outcome::Malformed))
                }
            };
            if let Some(answer) = answer {
                self.answer(number, answer);
            }
        }
        bytes.len()
    }

    /// Answers a request, now and when it comes again.
    pub(crate) fn answer(&mut self, number: Number, answer: Answer) {
        self.conversation.keep(number, &answer);
        self.queue.answer(number, answer);
    }

    /// A host says hello: it starts from a silent device that heats for no host, whoever talked before.
    fn pair(&mut self, access: &mut impl Access, theirs: &Hello) {
        self.end_host_power(access);
        let fits = check(self.queue.hello(), theirs).is_ok();
        self.paired = fits && !self.service.is_leaving();
        self.conversation = Conversation::default();
        self.queue.restart(access);
        self.forget_service(access);
        self.telemetry_every = 0;
        // Whoever comes must hear of an active fault, even if it was reported to somebody before.
        self.reported_fault = Fault::NONE;
        access.with(|rt| rt.set_windows_every(0));
        // One that does not fit sees it in ours.
        self.queue.tell(Answer::Hello);
    }

    /// Nobody is talked to until the next hello.
    pub(crate) fn unpair(&mut self) {
        self.paired = false;
        self.telemetry_every = 0;
    }

    fn host_power(&mut self, access: &mut impl Access, power_w: u16) -> (Outcome, u32) {
        let (fault, replaying) = access.with(|rt| (rt.fault(), rt.is_replaying()));
        if power_w > RATED_POWER_W {
            return (Outcome::PowerOutOfRange, u32::from(RATED_POWER_W));
        }
        if power_w > 0 && replaying {
            // Nothing may be heated; there is no fault to name.
            return (Outcome::FaultActive, 0);
        }
        if power_w > 0 && self.control.state() == State::LockedOut {
            return (Outcome::LockedOut, u32::from(fault.number()));
        }
        match self.control.host(power_w) {
            Some(action) => {
                self.act(access, action);
                (Outcome::Ok, 0)
            }
            None => (Outcome::PanelOff, 0),
        }
    }

    /// A person touches the panel.
    pub fn panel(&mut self, access: &mut impl Access, event: PanelEvent) {
        if self.service.is_leaving() {
            return;
        }
        let action = self.control.panel(event);
        self.act(access, action);
    }

    /// Codes of the temperature sensors, some hundred times a second.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.control.set_temperatures(codes);
    }

    /// Returns `true` if the fan is to run.
    pub fn fan(&self) -> bool {
        self.control.temperatures().fan()
    }

    fn clear_fault(&mut self, access: &mut impl Access) -> Answer {
        let action = self.control.clear_fault();
        self.act(access, action);
        let standing = access.with(|rt| rt.fault());
        let outcome = match standing {
            Fault::NONE => Outcome::Ok,
            _ if self.control.state() == State::LockedOut => Outcome::LockedOut,
            _ => Outcome::FaultActive,
        };
        reply(outcome, u32::from(standing.number()))
    }

    fn start_replay(&mut self, access: &mut impl Access, m: &ReplayStart) -> Answer {
        let off = self.control.switch_off();
        self.act(access, off);
        match self.replay.start(access, m) {
            Ok(mode) => self.replay_mode(mode),
            Err((outcome, detail)) => reply(outcome, detail),
        }
    }

    fn replay_mode(&mut self, mode: ReplayMode) -> Answer {
        self.queue.set_capability(CAP_REPLAYING, mode.active);
        Answer::ReplayMode(mode)
    }

    fn stream(&mut self, access: &mut impl Access, m: &Stream) -> Answer {
        self.telemetry_every = m.telemetry_every;
        access.with(|rt| rt.set_windows_every(m.windows_every));
        outcome(Outcome::Ok)
    }

    fn configure(&mut self, access: &mut impl Access, settings: Configure) -> Answer {
        match settings.check() {
            Ok(()) => {
                self.control.set_give_up_s(settings.give_up_s);
                access.with(|rt| rt.set_dither(settings.dither_permille));
                self.settings = settings;
                outcome(Outcome::Ok)
            }
            Err(field) => reply(Outcome::OutOfRange, field),
        }
    }

    /// A lookup that passed every check of its content: it must still be newer than what we have, and
    /// leave room for later ones.
    fn accept(&mut self, lookup: RlLookup) -> (Outcome, u32) {
        let highest = self.active.version.saturating_add(LOOKUP_VERSION_STEP);
        if self.pending.is_some() {
            (Outcome::Busy, 0)
        } else if lookup.version <= self.active.version {
            (Outcome::LookupStale, self.active.version)
        } else if lookup.version > highest {
            (Outcome::LookupStep, highest)
        } else {
            self.activate(lookup)
        }
    }

    /// At the half-cycle boundary, so that one half-cycle sees one lookup.
    fn activate(&mut self, lookup: RlLookup) -> (Outcome, u32) {
        if self.pending.is_some() {
            return (Outcome::Busy, 0);
        }
        self.pending = Some(lookup);
        (Outcome::Ok, 0)
    }

    /// To be called after each block: control, telemetry, faults. One step of the search for a
    /// frequency is the longest it does.
    #[inline(never)]
    pub fn poll(&mut self, access: &mut impl Access) {
        let (gathered, now) = access.with(|rt| {
            rt.note_turn();
            (rt.take_half_cycle(), Now::of(rt))
        });
        let action = match gathered.map(|half_cycle| half_cycle.summary()) {
            Some(glance) if glance.glance => self.control.on_half_cycle(&glance, &now),
            Some(summary) => self.on_half_cycle(access, &summary, &now),
            None => self.control.advance(&self.active, &now),
        };
        self.act(access, action);
        // What the bridge was just asked for counts.
        let now = access.with(|rt| Now::of(rt));
        let action = self.control.tick(&now);
        self.act(access, action);
        let (fault, half_cycle) = access.with(|rt| (rt.fault(), rt.fault_half_cycle()));
        if fault != self.reported_fault && self.paired && !self.queue.is_full() {
            self.reported_fault = fault;
            self.queue
                .tell(Answer::Fault(FaultEvent { half_cycle, fault }));
        }
    }

    #[inline(never)]
    fn on_half_cycle(&mut self, access: &mut impl Access, summary: &Summary, now: &Now) -> Action {
        if let Some(lookup) = self.pending.take() {
            access.with(|rt| rt.set_lookup_version(lookup.version));
            self.active = GuardedLookup::new(lookup);
            self.lookup_changes = self.lookup_changes.wrapping_add(1);
        }
        self.watch_host(access);
        self.queue.half_cycle(access);
        self.last = *summary;
        let action = self.control.on_half_cycle(summary, now);
        self.send_telemetry(access, summary);
        action
    }

    /// Power that was asked for over the link lapses with the link.
    fn watch_host(&mut self, access: &mut impl Access) {
        self.half_cycles_unheard = self.half_cycles_unheard.saturating_add(1);
        if self.half_cycles_unheard >= HOST_UNHEARD_HALF_CYCLES {
            self.end_host_power(access);
        }
    }

    fn end_host_power(&mut self, access: &mut impl Access) {
        if self.control.request().is_of_host() {
            let action = self.control.host_lost();
            self.act(access, action);
        }
    }

    fn act(&mut self, access: &mut impl Access, action: Action) {
        match action {
            Action::Keep => {}
            Action::Drive(drive) => access.with(|rt| rt.request(drive)),
            Action::Look => access.with(RealTime::request_look),
            Action::OffAtCrossing => access.with(RealTime::request_off_at_crossing),
            Action::Fault(fault) => access.with(|rt| rt.raise(fault)),
            Action::ClearFault => access.with(RealTime::clear_fault),
        }
    }

    #[inline(never)]
    fn send_telemetry(&mut self, access: &mut impl Access, s: &Summary) {
        let every = u32::from(self.telemetry_every);
        if !self.paired || every == 0 || !s.half_cycle.is_multiple_of(every) {
            return;
        }
        let fault = access.with(|rt| rt.fault());
        let (state, pot) = (self.control.state(), self.control.pot());
        let (asked_w, limit) = (self.control.asked_w(), self.control.limit());
        let lookup_version = self.active.version;
        let phase_mrad = if s.f_sw_hz > 0 && s.i_crest_ma > 0 {
            Tank::new(s.f_sw_hz, s.r, s.l).phase_mrad()
        } else {
            0
        };
        self.queue.telemetry(|seq, dropped| Telemetry {
            seq,
            dropped,
            half_cycle: s.half_cycle,
            state,
            fault,
            pot,
            f_sw_hz: s.f_sw_hz,
            r: s.r,
            l: s.l,
            i_crest_ma: s.i_crest_ma,
            power_mw: s.power_mw,
            phase_mrad,
            lookup_version,
            asked_w,
            limit,
            bus_peak_dv: s.bus_peak_dv,
            v_coil_peak_dv: u16::try_from(s.v_peak_dv.max(s.v_crest_dv())).unwrap_or(u16::MAX),
            i_turn_off_min_ma: if s.i_turn_off_min_ma == i32::MAX {
                0
            } else {
                s.i_turn_off_min_ma
            },
        });
    }

    #[inline(never)]
    fn status(&mut self, access: &mut impl Access) -> Status {
        let counters = self.deframer.counters();
        let telemetry_dropped = self.queue.telemetry_dropped();
        let (control, active, last) = (&self.control, &self.active, &self.last);
        let [heat_sink_c, glass_c, coil_c] = control
            .temperatures()
            .celsius()
            .map(|celsius| celsius.unwrap_or(NO_SENSOR_C));
        access.with(|rt| {
            let windows = rt.recorder().counters();
            Status {
                state: control.state(),
                fault: rt.fault(),
                pot: control.pot(),
                asked_w: control.asked_w(),
                delivered_mw: last.power_mw,
                f_sw_hz: if rt.drive().is_switching() {
                    rt.drive().f_sw_hz
                } else {
                    0
                },
                lookup_version: active.version,
                half_cycles: rt.half_cycles(),
                windows_recorded: windows.recorded,
                windows_dropped: windows.dropped,
                telemetry_dropped,
                frames_bad: counters.bad,
                frames_lost: counters.lost,
                saturated_pairs: rt.saturated_pairs(),
                limit: control.limit(),
                tries_left: control.restart().tries_left(),
                heat_sink_c,
                glass_c,
                coil_c,
                fan: control.temperatures().fan(),
                panel_level: control.request().level().unwrap_or(NO_PANEL),
                key_locked: control.request().is_key_locked(),
            }
        })
    }

    /// Writes the next frame for the link, if there is one; returns its length, 0 for none.
    pub fn transmit(&mut self, access: &mut impl Access, out: &mut [u8; MAX_ENCODED]) -> usize {
        self.queue.transmit(access, &self.active, out)
    }
}

/// An outcome with its detail.
fn reply(outcome: Outcome, detail: u32) -> Answer {
    Answer::Reply(Reply { outcome, detail })
}

/// An outcome that has no detail.
pub(crate) fn outcome(outcome: Outcome) -> Answer {
    reply(outcome, 0)
}

fn utilisation(realtime: &mut RealTime) -> Utilisation {
    let shares = realtime.utilisation().take();
    Utilisation {
        blocks: shares.blocks,
        mean_permille: shares.mean_permille,
        worst_permille: shares.worst_permille,
        longest_gap_us: realtime.take_longest_gap_us(),
    }
}
