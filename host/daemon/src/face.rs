//! A device as everybody but its own task sees it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ihd_link::AsyncClient;
use ihd_shared::wire::messages::{Hello, Telemetry};
use tokio::time::Instant;

use crate::board::Board;
use crate::firmware::usb_serial;
use crate::lease::LeaseBook;
use crate::ledger::Ledger;
use crate::live::LiveRing;
use crate::looks::Fits;
use crate::model::{DeviceReport, DeviceState, Identity, LookupReport, PotCurve, What};
use crate::pot_watch::PotWatch;
use crate::printable::printable;
use crate::recording::Recorder;
use crate::states::live;

/// What is known of a device, shared by its task, the commands and the threads of store and learner.
pub struct Face {
    /// Its name.
    pub name: String,
    /// Where it is, in words.
    pub address: String,
    /// Where notices go.
    pub board: Board,
    /// Records what comes from it.
    pub recorder: Recorder,
    inner: Mutex<Inner>,
    ring: Mutex<LiveRing>,
    fits: Mutex<Fits>,
    pot_watch: Mutex<PotWatch>,
    pot_curve: Mutex<PotCurve>,
}

/// What changes.
pub struct Inner {
    state: DeviceState,
    since: Instant,
    detail: String,
    /// Who it is.
    pub identity: Option<Identity>,
    /// What to update where its firmware does not fit; empty where it does.
    pub updates_needed: String,
    /// Its last half-cycle.
    pub last: Option<Telemetry>,
    /// Its lookup.
    pub lookup: LookupReport,
    /// Its windows.
    pub ledger: Ledger,
    /// The lease, and the power that was asked for under it.
    pub lease: LeaseBook,
    /// Powers of a sweep that are still to come.
    pub sweep_left_w: Vec<u16>,
    /// Connections so far.
    pub connections: u32,
    /// Frames that were more than a hob sends.
    pub frames_beyond: u64,
    /// What the store holds of its learning was given to the learner.
    pub is_resumed: bool,
    /// The connection, for whoever has to switch off when the device's task cannot.
    pub client: Option<Arc<AsyncClient>>,
}

impl Face {
    /// A device that nobody has looked for yet.
    pub fn new(name: String, address: String, board: Board, recorder: Recorder) -> Self {
        Self {
            name,
            address: printable(&address),
            board,
            recorder,
            ring: Mutex::default(),
            fits: Mutex::default(),
            pot_watch: Mutex::default(),
            pot_curve: Mutex::default(),
            inner: Mutex::new(Inner {
                state: DeviceState::Searching,
                since: Instant::now(),
                detail: String::new(),
                identity: None,
                updates_needed: String::new(),
                last: None,
                lookup: LookupReport::default(),
                ledger: Ledger::default(),
                lease: LeaseBook::default(),
                sweep_left_w: Vec::new(),
                connections: 0,
                frames_beyond: 0,
                is_resumed: false,
                client: None,
            }),
        }
    }

    /// What changes, for a moment: nothing waits in here.
    pub fn lock(&self) -> MutexGuard<'_, Inner> {
        // Every change is complete in itself.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Its last minute, for those who watch; held for a moment, too.
    pub fn ring(&self) -> MutexGuard<'_, LiveRing> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Its last fits; held for a moment, too.
    pub fn fits(&self) -> MutexGuard<'_, Fits> {
        self.fits.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Who follows its pot; held for as long as a fit takes, by one thread at a time.
    pub fn pot_watch(&self) -> MutexGuard<'_, PotWatch> {
        self.pot_watch
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// The same, where nobody holds it.
    pub fn try_pot_watch(&self) -> Option<MutexGuard<'_, PotWatch>> {
        self.pot_watch.try_lock().ok()
    }

    /// What is known of its pot; held for a moment.
    pub fn pot_curve(&self) -> MutexGuard<'_, PotCurve> {
        self.pot_curve
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Enters a state; told and logged where it is another, and silently where only the words are.
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
                tracing::warn!(device = self.name, state = state.word(), detail);
            }
            _ => tracing::info!(device = self.name, state = state.word(), detail),
        }
        self.tell(What::State { state, detail });
    }

    /// The state now, and for how long.
    pub fn state_and_age(&self) -> (DeviceState, Duration) {
        let inner = self.lock();
        (inner.state, inner.since.elapsed())
    }

    /// Why it is in its state.
    pub fn detail(&self) -> String {
        self.lock().detail.clone()
    }

    /// Tells whoever watches.
    pub fn tell(&self, what: What) {
        self.board.tell(&self.name, what);
    }

    /// The device as it is shown.
    pub fn report(&self) -> DeviceReport {
        let pot_temperature = self.pot_curve().now;
        let inner = self.lock();
        DeviceReport {
            pot_temperature,
            name: self.name.clone(),
            address: self.address.clone(),
            serial: usb_serial(&self.address).unwrap_or(&self.name).to_owned(),
            updates_needed: inner.updates_needed.clone(),
            state: inner.state,
            since_s: inner.since.elapsed().as_secs(),
            detail: inner.detail.clone(),
            identity: inner.identity.clone(),
            live: inner.last.as_ref().map(live),
            lookup: inner.lookup.clone(),
            windows: inner.ledger.counts(),
            asked_by_daemon_w: inner.lease.asked_w(),
            lease: inner.lease.current(Instant::now()),
            sweep_left_w: inner.sweep_left_w.clone(),
            recording: self.recorder.path().map(|path| path.display().to_string()),
            recording_now: self.recorder.now(),
            connections: inner.connections,
            frames_beyond: inner.frames_beyond,
        }
    }
}

/// Who sent a hello.
pub fn identity(hello: &Hello) -> Identity {
    Identity {
        build: printable(&hello.build),
        board: printable(&hello.board),
        protocol: (hello.protocol_major, hello.protocol_minor),
        boot_id: hello.boot_id,
        reset_reason: hello.reset_reason,
    }
}
