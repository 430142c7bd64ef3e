//! What runs below the sampling path: commands from the link, power control, the active lookup.

use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{LOOKUP_VERSION_STEP, RlLookup};
use ihd_shared::wire::RESEND_MINOR;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_REPLAYING, check};
use ihd_shared::wire::messages::{
    AnyMessage, ClearFault, Configure, DecodeError, FaultEvent, Hello, Message, NO_PANEL,
    NO_SENSOR_C, Outcome, PushLookup, ReplayBlocks, ReplayMode, ReplayStart, Reply, ResendWindow,
    ResetLookup, SetPower, State, Status, Stream, Telemetry, Utilisation,
};
use ihd_shared::wire::timing::HOST_UNHEARD_HALF_CYCLES;

use crate::control::{Action, Control, Now};
use crate::half_cycle::Summary;
use crate::impedance::Tank;
use crate::realtime::{Access, RealTime};
use crate::replay::{Replay, Replayed};
use crate::request::PanelEvent;
use crate::self_test::guarded::GuardedLookup;
use crate::service::Service;
use crate::temperature::TemperatureCodes;
use crate::transmit_queue::{Answer, TransmitQueue};

/// The link's incoming side, control and lookup.
pub struct Housekeeping {
    deframer: Deframer,
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

    /// Whether the lookup in use is still what it was when it became that (a self-test).
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

    /// How often another lookup became active since boot: who keeps it sees from this when. Its version
    /// may return after a reset.
    pub fn lookup_changes(&self) -> u32 {
        self.lookup_changes
    }

    /// What a host has set, else [`Configure::DEFAULT`].
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
            let (id, seq) = (frame.id, frame.seq);
            // A host sends it by itself for as long as windows come: it answers for no power.
            if id != ResendWindow::ID {
                self.half_cycles_unheard = 0;
            }
            match AnyMessage::decode(id, frame.payload) {
                // These two borrow from the deframer; the rest may borrow all of self.
                Ok(AnyMessage::PushLookup(push)) if self.paired => {
                    let offered = RlLookup::from_bytes(push.blob.0);
                    let (outcome, detail) = match offered {
                        Ok(lookup) => self.accept(lookup),
                        Err(why) => why.outcome(),
                    };
                    self.reply(PushLookup::ID, outcome, detail);
                }
                Ok(AnyMessage::ReplayBlocks(blocks)) if self.paired => {
                    match self.replay.blocks(access, &blocks, seq) {
                        Some(Replayed::Estimates(estimates)) => {
                            self.queue.answer(Answer::ReplayEstimates(estimates));
                        }
                        Some(Replayed::NotReplaying(mode)) => {
                            self.queue.answer(Answer::ReplayMode(mode));
                        }
                        None => self.reply(ReplayBlocks::ID, Outcome::Malformed, 0),
                    }
                }
                Ok(AnyMessage::LinkData(data)) if self.paired => self.service.take_link_data(&data),
                Ok(AnyMessage::Hello(theirs)) => self.pair(access, &theirs),
                _ if !self.paired => self.reply(id, Outcome::NotPaired, 0),
                Ok(AnyMessage::SetPower(m)) => self.set_power(access, &m),
                Ok(AnyMessage::Stream(m)) => self.stream(access, &m),
                Ok(AnyMessage::GetStatus(_)) => {
                    let status = self.status(access);
                    self.queue.answer(Answer::Status(status));
                }
                Ok(AnyMessage::ReadLookup(_)) => self.queue.answer(Answer::Lookup),
                Ok(AnyMessage::ResetLookup(_)) => {
                    let (outcome, detail) = self.activate(prior());
                    self.reply(ResetLookup::ID, outcome, detail);
                }
                Ok(AnyMessage::Configure(m)) => self.configure(access, m),
                Ok(AnyMessage::GetFrontEnd(_)) => self.queue.answer(Answer::FrontEnd),
                Ok(AnyMessage::ResendWindow(m)) => self.queue.resend(access, m),
                Ok(AnyMessage::ClearFault(_)) => self.clear_fault(access),
                Ok(AnyMessage::GetUtilisation(_)) => {
                    let utilisation = access.with(utilisation);
                    self.queue.answer(Answer::Utilisation(utilisation));
                }
                Ok(AnyMessage::ReplayStart(m)) => self.start_replay(access, &m),
                Ok(AnyMessage::ReplayEnd(_)) => {
                    let mode = self.replay.end(access);
                    self.answer_replay_mode(mode);
                }
                Ok(AnyMessage::Restart(m)) => self.ask_restart(m.into),
                Ok(AnyMessage::GetBoard(_)) => self.queue.answer(Answer::Board),
                Ok(AnyMessage::TestBoard(m)) => self.ask_board_test(m.test),
                Ok(AnyMessage::TestLink(m)) => self.test_link(&m),
                Ok(AnyMessage::StreamLog(m)) => self.stream_log(m.on),
                Ok(_) | Err(DecodeError::UnknownId { .. }) => {
                    self.reply(id, Outcome::UnknownMessage, 0);
                }
                Err(DecodeError::Malformed { .. } | DecodeError::Trailing { .. }) => {
                    self.reply(id, Outcome::Malformed, 0);
                }
            }
        }
        bytes.len()
    }

    pub(crate) fn reply(&mut self, to: u8, outcome: Outcome, detail: u32) {
        self.queue.answer(Answer::Reply(Reply {
            to,
            outcome,
            detail,
        }));
    }

    /// A host says hello: it starts from a silent device, whoever talked before.
    fn pair(&mut self, access: &mut impl Access, theirs: &Hello) {
        let fits = check(self.queue.hello(), theirs).is_ok();
        self.paired = fits && !self.service.is_leaving();
        let minor = self.queue.hello().protocol_minor.min(theirs.protocol_minor);
        let asks_again = self.paired && minor >= RESEND_MINOR;
        self.queue.restart(access, asks_again);
        self.replay.forget_sequence();
        self.forget_service(access);
        self.telemetry_every = 0;
        // Whoever comes must hear of an active fault, even if it was reported to somebody before.
        self.reported_fault = Fault::NONE;
        access.with(|rt| rt.set_windows_every(0));
        self.queue.answer(Answer::Hello);
        if self.paired {
            self.queue.answer(Answer::FrontEnd);
        } else {
            self.reply(Hello::ID, Outcome::NotPaired, 0);
        }
    }

    /// Nobody is talked to until the next hello.
    pub(crate) fn unpair(&mut self) {
        self.paired = false;
        self.telemetry_every = 0;
    }

    fn set_power(&mut self, access: &mut impl Access, m: &SetPower) {
        let (outcome, detail) = self.host_power(access, m.power_w);
        self.reply(SetPower::ID, outcome, detail);
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

    /// Whether the fan is to run.
    pub fn fan(&self) -> bool {
        self.control.temperatures().fan()
    }

    fn clear_fault(&mut self, access: &mut impl Access) {
        let action = self.control.clear_fault();
        self.act(access, action);
        let standing = access.with(|rt| rt.fault());
        let outcome = match standing {
            Fault::NONE => Outcome::Ok,
            _ if self.control.state() == State::LockedOut => Outcome::LockedOut,
            _ => Outcome::FaultActive,
        };
        self.reply(ClearFault::ID, outcome, u32::from(standing.number()));
    }

    fn start_replay(&mut self, access: &mut impl Access, m: &ReplayStart) {
        let off = self.control.switch_off();
        self.act(access, off);
        match self.replay.start(access, m) {
            Ok(mode) => self.answer_replay_mode(mode),
            Err((outcome, detail)) => self.reply(ReplayStart::ID, outcome, detail),
        }
    }

    fn answer_replay_mode(&mut self, mode: ReplayMode) {
        self.queue.set_capability(CAP_REPLAYING, mode.active);
        self.queue.answer(Answer::ReplayMode(mode));
    }

    fn stream(&mut self, access: &mut impl Access, m: &Stream) {
        self.telemetry_every = m.telemetry_every;
        access.with(|rt| rt.set_windows_every(m.windows_every));
        self.reply(Stream::ID, Outcome::Ok, 0);
    }

    fn configure(&mut self, access: &mut impl Access, settings: Configure) {
        match settings.check() {
            Ok(()) => {
                self.control.set_give_up_s(settings.give_up_s);
                access.with(|rt| rt.set_dither(settings.dither_permille));
                self.settings = settings;
                self.reply(Configure::ID, Outcome::Ok, 0);
            }
            Err(field) => self.reply(Configure::ID, Outcome::OutOfRange, field),
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
                .answer(Answer::Fault(FaultEvent { half_cycle, fault }));
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
        if self.half_cycles_unheard >= HOST_UNHEARD_HALF_CYCLES
            && self.control.request().is_of_host()
        {
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

fn utilisation(realtime: &mut RealTime) -> Utilisation {
    let shares = realtime.utilisation().take();
    Utilisation {
        blocks: shares.blocks,
        mean_permille: shares.mean_permille,
        worst_permille: shares.worst_permille,
        longest_gap_us: realtime.take_longest_gap_us(),
    }
}
