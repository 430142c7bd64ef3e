//! A device as everybody but its own task sees it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ihd_link::AsyncClient;
use ihd_shared::wire::messages::{Hello, Telemetry};

use crate::board::Board;
use crate::lease::LeaseBook;
use crate::ledger::Ledger;
use crate::model::{DeviceReport, DeviceState, Identity, LookupReport, What};
use crate::printable::printable;
use crate::states::live;

/// What is known of a device, shared by its task, the commands and the threads of store and learner.
pub struct Face {
    /// Its name.
    pub name: String,
    /// Where it is, in words.
    pub address: String,
    /// Where notices go.
    pub board: Board,
    inner: Mutex<Inner>,
}

/// What changes.
pub struct Inner {
    state: DeviceState,
    since: Instant,
    detail: String,
    /// Who it is.
    pub identity: Option<Identity>,
    /// Its last half-cycle.
    pub last: Option<Telemetry>,
    /// Its lookup.
    pub lookup: LookupReport,
    /// Its windows.
    pub ledger: Ledger,
    /// Power that was asked for through the daemon, in watt; it has to be taken back.
    pub asked_w: u16,
    /// Who may command it.
    pub lease: LeaseBook,
    /// Powers of a sweep that are still to come.
    pub sweep_left_w: Vec<u16>,
    /// File that is recorded into.
    pub recording: Option<String>,
    /// Connections so far.
    pub connections: u32,
    /// What the store holds of its learning was given to the learner.
    pub is_resumed: bool,
    /// The connection, for whoever has to switch off when the device's task cannot.
    pub client: Option<Arc<AsyncClient>>,
}

impl Face {
    /// A device that nobody has looked for yet.
    pub fn new(name: String, address: String, board: Board) -> Self {
        Self {
            name,
            address: printable(&address),
            board,
            inner: Mutex::new(Inner {
                state: DeviceState::Searching,
                since: Instant::now(),
                detail: String::new(),
                identity: None,
                last: None,
                lookup: LookupReport::default(),
                ledger: Ledger::default(),
                asked_w: 0,
                lease: LeaseBook::default(),
                sweep_left_w: Vec::new(),
                recording: None,
                connections: 0,
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
        let inner = self.lock();
        DeviceReport {
            name: self.name.clone(),
            address: self.address.clone(),
            state: inner.state,
            since_s: inner.since.elapsed().as_secs(),
            detail: inner.detail.clone(),
            identity: inner.identity.clone(),
            live: inner.last.as_ref().map(live),
            lookup: inner.lookup.clone(),
            windows: inner.ledger.counts(),
            asked_by_daemon_w: inner.asked_w,
            lease: inner.lease.current(Instant::now()),
            sweep_left_w: inner.sweep_left_w.clone(),
            recording: inner.recording.clone(),
            connections: inner.connections,
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
