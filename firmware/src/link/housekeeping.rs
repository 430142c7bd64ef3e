//! Housekeeping, once a block in the thread: commands from the link, control, telemetry, the active lookup.

use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::messages::{Configure, FaultEvent, Hello};
use ihd_shared::wire::timing::HOST_UNHEARD_MS;

use crate::control::controller::Control;
use crate::control::request::PanelEvent;
use crate::control::share_wire::WireDrive;
use crate::control::status::{Action, SamplingStatus};
use crate::control::temperature::TemperatureCodes;
use crate::link::active_lookup::ActiveLookup;
use crate::link::conversation::Conversation;
use crate::link::identity::DeviceIdentity;
use crate::link::log_ring::LinkLog;
use crate::link::replay::Replay;
use crate::link::report;
use crate::link::response::Response;
use crate::link::service::Service;
use crate::link::transmit_queue::TransmitQueue;
use crate::retained::control::RetainedControl;
use crate::sampling::half_cycle::HalfCycle;
use crate::sampling::path::{SamplingLock, SamplingPath};
use crate::sense::supply::{Reference, SupplyScale};

mod requests;

/// Everything that the thread owns: the conversation with a host, control, the active lookup.
pub struct Housekeeping {
    deframer: Deframer,
    conversation: Conversation,
    queue: TransmitQueue,
    control: Control,
    service: Service,
    /// A host's hello has been answered, and it fits.
    paired: bool,
    /// Half-cycles from telemetry to telemetry; 0 for none.
    telemetry_every: u8,
    lookup: ActiveLookup,
    settings: Configure,
    /// The fault that the host was told of last.
    reported_fault: Fault,
    /// Time of the host's last request or hello, in milliseconds.
    heard_ms: u32,
    /// The last half-cycle.
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
            heard_ms: 0,
            last: HalfCycle::default(),
            replay: Replay::default(),
        }
    }

    /// Starts from a lookup that was kept, in place of the prior ([`ActiveLookup::restore`]); windows name it from the first one on.
    pub fn restore(&mut self, lock: &mut impl SamplingLock, lookup: RlLookup) {
        self.lookup.restore(lookup);
        let version = self.lookup.version;
        lock.with(|path| path.recorder().set_lookup_version(version));
    }

    /// Goes on with what control kept through a reset; `fault` was active then, and is again if it has locked out.
    pub fn restore_control(
        &mut self,
        lock: &mut impl SamplingLock,
        kept: RetainedControl,
        fault: Fault,
    ) {
        let status = lock.with(|path| {
            if kept.locked_out {
                path.raise(fault);
            }
            SamplingStatus::read(path)
        });
        self.control.restore(kept, &status);
    }

    /// Sets the identity of the device, before a host connects.
    pub fn set_identity(&mut self, identity: DeviceIdentity) {
        self.queue.set_identity(identity);
    }

    /// Sets the place where the log is kept until it is sent.
    pub fn set_log(&mut self, log: &'static LinkLog) {
        self.queue.set_log(log);
    }
}

/// Readings for the board.
impl Housekeeping {
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

    /// Returns `true` if the fan is to run.
    pub fn fan(&self) -> bool {
        self.control.temperatures().fan()
    }
}

/// Readings and touches from the board.
impl Housekeeping {
    /// Takes a person's touch of the panel.
    pub fn panel(&mut self, lock: &mut impl SamplingLock, event: PanelEvent) {
        if self.service.is_leaving() {
            return;
        }
        // A person does not wait for a recording.
        self.end_replay(lock);
        let action = self.control.panel(event);
        self.act(lock, action);
    }

    /// Takes the level of the wire to the other zone of a shared supply ([`Control::share_supply`]).
    pub fn share_supply(&mut self, lock: &mut impl SamplingLock, is_high: bool) -> WireDrive {
        let now_ms = lock.with(|path| path.now_ms());
        self.control.share_supply(is_high, now_ms)
    }

    /// Lets minutes pass at once for the times of cooking, on a simulated hob.
    pub fn pass_minutes(&mut self, lock: &mut impl SamplingLock, minutes: u16) {
        let action = self.control.pass_minutes(minutes);
        self.act(lock, action);
    }

    /// Takes a reading of the chip's reference voltage, some hundred times a second; returns the correction of every reading
    /// from now on.
    pub fn set_reference(&mut self, reference: Reference) -> SupplyScale {
        self.control.set_reference(reference);
        self.control.supply_scale()
    }

    /// Takes the codes of the temperature sensors, up to a thousand times a second.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.control.set_temperatures(codes);
    }
}

/// Turns, after each block.
impl Housekeeping {
    /// Runs control, telemetry and faults; to be called after each block. One step of the search for a
    /// frequency is the longest it does.
    #[inline(never)]
    pub fn poll(&mut self, lock: &mut impl SamplingLock) {
        let (sums, status) = lock.with(|path| {
            path.housekeeping_gap().end();
            (path.take_half_cycle(), SamplingStatus::read(path))
        });
        let action = match sums.map(|sums| sums.evaluate()) {
            Some(probe) if probe.is_pot_probe => self.control.on_half_cycle(&probe, &status),
            Some(summary) => self.on_half_cycle(lock, &summary, &status),
            None => {
                if self.lookup.has_successor() && self.control.needs_no_lookup(&status) {
                    self.activate_lookup(lock);
                }
                self.control.advance(&self.lookup, &status)
            }
        };
        self.act(lock, action);
        // The request that was just made counts.
        let status = lock.with(|path| SamplingStatus::read(path));
        self.watch_host(lock, &status);
        let action = self.control.tick(&status);
        self.act(lock, action);
        let (fault, half_cycle) = lock.with(|path| (path.fault(), path.fault_half_cycle()));
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
        self.activate_lookup(lock);
        self.queue.on_half_cycle(lock);
        self.last = *summary;
        let action = self.control.on_half_cycle(summary, status);
        self.send_telemetry(lock, summary);
        action
    }

    /// Activates a lookup that waits for its turn.
    // Not in the caller's frame, which would have room for a lookup in every block.
    #[inline(never)]
    fn activate_lookup(&mut self, lock: &mut impl SamplingLock) {
        if let Some(version) = self.lookup.activate() {
            lock.with(|path| path.recorder().set_lookup_version(version));
        }
    }

    /// Ends power and replay that were requested over the link with the link, with or without mains.
    fn watch_host(&mut self, lock: &mut impl SamplingLock, status: &SamplingStatus) {
        if status.now_ms.wrapping_sub(self.heard_ms) >= HOST_UNHEARD_MS {
            self.end_host_power(lock);
            if status.replaying {
                self.end_replay(lock);
            }
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
            Action::Drive(drive) => lock.with(|path| path.request(drive)),
            Action::ProbePot(probe) => lock.with(|path| path.request_pot_probe(probe)),
            Action::OffAtCrossing => lock.with(SamplingPath::request_off_at_crossing),
            Action::Fault(fault) => lock.with(|path| path.raise(fault)),
            Action::ClearFault => lock.with(SamplingPath::clear_fault),
        }
    }

    #[inline(never)]
    fn send_telemetry(&mut self, lock: &mut impl SamplingLock, s: &HalfCycle) {
        let every = u32::from(self.telemetry_every);
        if !self.paired || every == 0 || !s.half_cycle.is_multiple_of(every) {
            return;
        }
        let fault = lock.with(|path| path.fault());
        let (control, version) = (&self.control, self.lookup.version);
        self.queue
            .telemetry(|seq, dropped| report::telemetry(seq, dropped, s, fault, control, version));
    }

    /// Writes the next frame for the link, if there is one; returns its length, 0 for none.
    pub fn transmit(&mut self, lock: &mut impl SamplingLock, out: &mut [u8; MAX_ENCODED]) -> usize {
        self.queue.transmit(lock, &self.lookup, out)
    }
}
