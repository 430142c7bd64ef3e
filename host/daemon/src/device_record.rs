//! State of a device that its task shares with the rest of the daemon.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use ihd_capture::recording::RecordingSession;
use ihd_link::AsyncClient;
use ihd_model::{
    DeviceReport, DeviceState, EventKind, Identity, Live, LookupReport, PotCurve, RecordKind,
};
use ihd_shared::wire::messages::{Hello, Telemetry};
use tokio::time::Instant;

use crate::event_bus::EventBus;
use crate::firmware::usb_serial;
use crate::lease::LeaseBook;
use crate::live::recent_power::RecentPower;
use crate::live::ring::LiveRing;
use crate::locking::lock;
use crate::pot_tracker::PotTracker;
use crate::printable::printable;
use crate::states::live;
use crate::store_thread::StoreAccess;
use crate::view::recent_fits::RecentFits;
use crate::window_accounting::WindowAccounting;

/// Shared state of a device: used by its task, by commands and by the threads of store and learner.
pub struct DeviceRecord {
    /// Name of the device.
    pub name: String,
    /// Address as text.
    pub address: String,
    /// Bus for the events of the device.
    pub event_bus: EventBus,
    /// Recording of its links.
    pub recorder: RecordingSession,
    /// `true` once the board is unplugged and this record is replaced by the next one: its recording goes on there.
    pub is_unplugged: AtomicBool,
    inner: Mutex<Inner>,
    ring: Mutex<LiveRing>,
    fits: Mutex<RecentFits>,
    pot_tracker: Mutex<PotTracker>,
    pot_curve: Mutex<PotCurve>,
}

/// Mutable state, behind [`DeviceRecord::lock`].
pub struct Inner {
    state: DeviceState,
    since: Instant,
    detail: String,
    /// Identity; `None` before the first handshake.
    pub identity: Option<Identity>,
    /// Update advice; empty if the firmware matches this daemon.
    pub updates_needed: String,
    /// Last half-cycle of this connection; `None` before the first telemetry.
    pub last: Option<Telemetry>,
    /// Mean power of the last second.
    pub power: RecentPower,
    /// Versions of its lookup.
    pub lookup: LookupReport,
    /// Counts of its windows.
    pub windows: WindowAccounting,
    /// Lease with the power requested under it.
    pub lease: LeaseBook,
    /// Remaining powers of a sweep, in watt.
    pub sweep_left_w: Vec<u16>,
    /// `true` if the last sweep ended after its last power.
    pub sweep_is_complete: bool,
    /// Number of connections so far.
    pub connections: u32,
    /// Frames dropped because they exceeded what a hob sends.
    pub frames_beyond: u64,
    /// `true` once the learner has the learning state of the store.
    pub is_resumed: bool,
    /// Connection, for switching off without the device's task; `None` if not connected.
    pub client: Option<Arc<AsyncClient>>,
}

impl Inner {
    /// Returns the report of the last half-cycle; `None` before the first telemetry.
    pub fn live(&self) -> Option<Live> {
        self.last.as_ref().map(|last| live(last, &self.power))
    }
}

impl DeviceRecord {
    /// Creates the record of a device, in state `Searching`.
    pub fn new(
        name: String,
        address: String,
        event_bus: EventBus,
        recorder: RecordingSession,
    ) -> Self {
        Self {
            name,
            address: printable(&address),
            event_bus,
            recorder,
            is_unplugged: AtomicBool::new(false),
            ring: Mutex::default(),
            fits: Mutex::default(),
            pot_tracker: Mutex::default(),
            pot_curve: Mutex::default(),
            inner: Mutex::new(Inner {
                state: DeviceState::Searching,
                since: Instant::now(),
                detail: String::new(),
                identity: None,
                updates_needed: String::new(),
                last: None,
                power: RecentPower::default(),
                lookup: LookupReport::default(),
                windows: WindowAccounting::default(),
                lease: LeaseBook::default(),
                sweep_left_w: Vec::new(),
                sweep_is_complete: false,
                connections: 0,
                frames_beyond: 0,
                is_resumed: false,
                client: None,
            }),
        }
    }

    /// Publishes that nobody has the lease any more, for this reason.
    pub fn publish_lease_end(&self, why: String) {
        self.publish(EventKind::Lease {
            holder: String::new(),
            taken_from: String::new(),
            why,
        });
    }

    /// Stores an event of the device. Without room in the store it is dropped and counted.
    pub fn store_event(&self, store: StoreAccess, kind: &'static str, text: &str) {
        let (name, address) = (self.name.clone(), self.address.clone());
        let text = printable(text);
        store.writing_once(RecordKind::Events).offer(move |store| {
            let device = store.device(&name, &address)?;
            store.event(Some(device), kind, &text)
        });
    }

    /// Locks the mutable state; held only for a moment, never over a wait.
    pub fn lock(&self) -> MutexGuard<'_, Inner> {
        lock(&self.inner)
    }

    /// Locks the last minute of telemetry; held only for a moment.
    pub fn ring(&self) -> MutexGuard<'_, LiveRing> {
        lock(&self.ring)
    }

    /// Locks the last fits; held only for a moment.
    pub fn fits(&self) -> MutexGuard<'_, RecentFits> {
        lock(&self.fits)
    }

    /// Locks the tracker of its pot; held for as long as a fit takes.
    pub fn pot_tracker(&self) -> MutexGuard<'_, PotTracker> {
        lock(&self.pot_tracker)
    }

    /// Locks the tracker of its pot without waiting; `None` if it is locked.
    pub fn try_pot_tracker(&self) -> Option<MutexGuard<'_, PotTracker>> {
        self.pot_tracker.try_lock().ok()
    }

    /// Locks the temperature curve of its pot; held only for a moment.
    pub fn pot_curve(&self) -> MutexGuard<'_, PotCurve> {
        lock(&self.pot_curve)
    }

    /// Enters a state. A new state is published and logged; a new detail alone only in `Searching` and `Faulted`.
    pub fn enter(&self, state: DeviceState, detail: &str) {
        let detail = printable(detail);
        {
            let mut inner = self.lock();
            let same = inner.state == state;
            if same && inner.detail == detail {
                return;
            }
            if !same {
                inner.since = Instant::now();
            }
            inner.state = state;
            inner.detail.clone_from(&detail);
            if same && state != DeviceState::Searching && state != DeviceState::Faulted {
                return;
            }
        }
        match state {
            DeviceState::Faulted | DeviceState::Incompatible | DeviceState::Suspended => {
                tracing::warn!(device = self.name, state = state.as_str(), detail);
            }
            _ => tracing::info!(device = self.name, state = state.as_str(), detail),
        }
        self.publish(EventKind::State { state, detail });
    }

    /// Returns the state and the time since it was entered.
    pub fn state_and_age(&self) -> (DeviceState, Duration) {
        let inner = self.lock();
        (inner.state, inner.since.elapsed())
    }

    /// Returns the reason of the state; may be empty.
    pub fn detail(&self) -> String {
        self.lock().detail.clone()
    }

    /// Publishes an event of this device.
    pub fn publish(&self, kind: EventKind) {
        self.event_bus.publish(&self.name, kind);
    }

    /// Returns the report for API and terminal.
    pub fn report(&self) -> DeviceReport {
        let pot_temperature = self.pot_curve().now;
        let inner = self.lock();
        let is_heard = inner.state.is_heard();
        DeviceReport {
            pot_temperature: pot_temperature.filter(|_| is_heard),
            name: self.name.clone(),
            address: self.address.clone(),
            serial: usb_serial(&self.address).unwrap_or(&self.name).to_owned(),
            updates_needed: inner.updates_needed.clone(),
            state: inner.state,
            since_s: inner.since.elapsed().as_secs(),
            detail: inner.detail.clone(),
            identity: inner.identity.clone(),
            live: inner.live().filter(|_| is_heard),
            lookup: inner.lookup.clone(),
            windows: inner.windows.counts(),
            asked_by_daemon_w: inner.lease.asked_w(),
            lease: inner.lease.current(Instant::now()),
            sweep_left_w: inner.sweep_left_w.clone(),
            sweep_is_complete: inner.sweep_is_complete,
            recording: self.recorder.path().map(|path| path.display().to_string()),
            recording_now: self.recorder.active(),
            recording_failure: self.recorder.failure().map(|why| printable(&why)),
            connections: inner.connections,
            frames_beyond: inner.frames_beyond,
        }
    }
}

/// Returns the identity that a hello states.
pub fn identity(hello: &Hello) -> Identity {
    Identity {
        build: printable(&hello.build),
        board: printable(&hello.board),
        protocol: (hello.protocol_major, hello.protocol_minor),
        boot_id: hello.boot_id,
        reset_reason: hello.reset_reason,
    }
}
