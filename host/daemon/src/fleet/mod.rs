//! Interface of the daemon to its part in a fleet (docs/fleet.md): windows and events to send, answers and lookups received.
//!
//! The daemon itself has no connection to the server. While windows are delegated ([`FleetAccess::delegate_until`]), it does not identify them
//! itself; workers' answers take the place of its own results. The delegation expires unless it is renewed.

pub mod delegation;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use ihd_link::Window;
use ihd_map::library::{Library, PotEntry, Provenance};
use ihd_model::{FleetReport, FleetStates};
use ihd_shared::lookup::RlLookup;
use ihd_store::{
    DeliveryState, DeviceId, DueWindow, EventRow, FleetMark, FleetState, GiveUpReason, OutboxItem,
    SessionId, Store, StoreError,
};
use ihd_train::learning::Contradiction;
use tokio::sync::oneshot;
use tokio::time::Instant;

pub use self::delegation::DELEGATION_TIME;
use self::delegation::Delegation;
pub use crate::config::fleet::{FleetConfig, host_name, is_encrypted, without_secrets};
use crate::fleet_view::FleetView;
use crate::learning::{
    LearnInput, LearnJob, LearnerSlot, LearningInUse, WorkerAnswer, WorkerFigures, power_w,
};
use crate::printable::printable;
use crate::store_thread::{StoreThread, StoreThreadError};
use crate::supervisor::Devices;

/// Outcome of a worker's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiveOutcome {
    /// The result is stored.
    Stored,
    /// The window already had a result.
    Duplicate,
    /// Unknown device or boot: it belongs to another edge, or is older than the store.
    Foreign,
    /// The store has no such window, or the window was never sent to the fleet.
    Unrequested,
    /// The window's samples were deleted meanwhile, without which no answer is checked.
    TooLate,
}

/// Result of the check of a lookup against a hob's own windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LookupCheck {
    /// No contradiction, or no windows.
    Agrees,
    /// Contradiction at this place.
    Contradicts(Contradiction),
    /// The learning is in use; the check can be repeated later.
    Unavailable,
}

/// Reason why an answer was not stored; it can be repeated.
#[derive(Debug, thiserror::Error)]
pub enum ReceiveError {
    /// Error of the store.
    #[error(transparent)]
    Store(#[from] StoreThreadError),
    /// The learner's queue is full, or the learner has ended.
    #[error("the learner's queue is full")]
    NoRoom,
    /// The fleet has not acknowledged the window yet.
    #[error("the fleet has not acknowledged its window yet")]
    NotSent,
}

/// Window that was sent to the fleet and has no result yet.
struct SentWindow {
    device_id: DeviceId,
    session: SessionId,
    window: Box<Window>,
}

/// Access for the daemon's part in a fleet.
pub struct FleetAccess {
    pub(crate) devices: Arc<Devices>,
    pub(crate) store: StoreThread,
    pub(crate) learner: LearnerSlot,
    pub(crate) delegation: Arc<Delegation>,
    /// Last report of the fleet.
    pub(crate) report: FleetView,
    /// Folder of the store.
    pub(crate) folder: PathBuf,
}

impl FleetAccess {
    /// Runs `f` on the store's thread.
    async fn in_store<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreThreadError> {
        self.store.run(f).await
    }

    /// Returns the fleet report; `None` if this daemon is no edge of a fleet.
    pub fn report(&self) -> Option<Arc<FleetReport>> {
        self.report.get()
    }

    /// Replaces the fleet report; from then on this daemon is an edge.
    pub fn set_report(&self, report: FleetReport) {
        self.report.set(report);
    }

    /// Returns the time since the last half-cycle of a device; `None` without one.
    pub fn telemetry_age(&self, device: &str) -> Option<Duration> {
        let handle = self.devices.get(device)?;
        let inner = handle.record.lock();
        inner.power.last_at().map(|at| at.elapsed())
    }

    /// Leaves windows to the fleet until a time, at most [`DELEGATION_TIME`] from now, except those of some hobs; the daemon identifies the
    /// others itself, and all after that time, or at once if `until` is `None`.
    pub fn delegate_until(&self, until: Option<Instant>, except: BTreeSet<String>) {
        self.delegation.except(except);
        self.delegation.renew(until);
    }

    /// Returns `true` while windows are left to the fleet.
    pub fn is_delegated(&self) -> bool {
        self.delegation.is_delegated()
    }

    /// Returns the oldest windows of these hobs that are due at the fleet, at most `limit`, without those that are being identified here.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn due_windows(
        &self,
        hobs: Vec<String>,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreThreadError> {
        let learner = self.learner.get();
        let held = learner.as_ref().map_or(0, |learner| learner.most_pending());
        let due = self.in_store(move |store| store.due(Some(&hobs), limit + held));
        let mut due = due.await?;
        if let Some(learner) = learner {
            due.retain(|w| !learner.is_pending(&w.device, w.boot, w.seq));
        }
        due.truncate(limit);
        Ok(due)
    }

    /// Returns the number of windows that are due at the fleet.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn count_due(&self) -> Result<u64, StoreThreadError> {
        self.in_store(ihd_store::Store::count_due).await
    }

    /// Reads the window, or its result, to be sent.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn read_due(&self, due: DueWindow) -> Result<OutboxItem, StoreThreadError> {
        self.in_store(move |store| store.read_due(&due)).await
    }

    /// Records due windows as sent, or as given up.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn mark_sent(
        &self,
        sent: Vec<(DueWindow, DeliveryState)>,
    ) -> Result<(), StoreThreadError> {
        self.in_store(move |store| store.mark_sent(&sent)).await
    }

    /// Marks windows as due again that the fleet received before a time (milliseconds since 1970, UTC) and never answered; returns their number.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn requeue_unanswered(&self, before_ms: i64) -> Result<u64, StoreThreadError> {
        self.in_store(move |store| store.requeue_unanswered(before_ms))
            .await
    }

    /// Returns windows that the fleet received before a time (milliseconds since 1970, UTC) and has not answered: at most `limit`, after the first `skip`.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn unanswered(
        &self,
        before_ms: i64,
        skip: usize,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreThreadError> {
        self.in_store(move |store| store.unanswered(before_ms, skip, limit))
            .await
    }

    /// Records that the fleet has given up a window that was sent.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn mark_given_up(
        &self,
        window: &DueWindow,
        why: &str,
    ) -> Result<(), StoreThreadError> {
        let (window, why) = (window.clone(), printable(why));
        self.in_store(move |store| {
            store.mark_given_up(&window.device, window.boot, window.seq, &why)
        })
        .await
    }

    /// Counts all windows in the store by their progress with the fleet. Reads day by day, so that other accesses do not wait for long.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn tally(&self) -> Result<FleetStates, StoreThreadError> {
        let days = self.in_store(|store| store.days_of_windows()).await?;
        let mut all = FleetStates::default();
        for day in days {
            all = all.and(self.in_store(move |store| store.fleet_tally(&day)).await?);
        }
        Ok(all)
    }

    /// Reads a stored mark of the fleet's server.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn mark(&self, mark: FleetMark) -> Result<Option<i64>, StoreThreadError> {
        self.in_store(move |store| store.fleet_mark(mark)).await
    }

    /// Stores a mark of the fleet's server.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn set_mark(&self, mark: FleetMark, value: i64) -> Result<(), StoreThreadError> {
        self.in_store(move |store| store.mark_fleet(mark, value))
            .await
    }

    /// Returns the store's folder.
    pub fn store_folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the skew in seconds to remove from the current of a device's windows; `None` if unknown.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        self.learner.get()?.skew_s(device)
    }

    /// Returns the secret of this daemon's store, by which the fleet recognises its messages.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn secret(&self) -> Result<[u8; 16], StoreThreadError> {
        self.in_store(ihd_store::Store::fleet_secret).await
    }

    /// Returns the pot on a device as an entry for other hobs' library; `None` if too little is known.
    pub fn pot_entry(&self, device: &str, by: Provenance) -> Option<PotEntry> {
        self.learner.get()?.pot_entry(device, by)
    }

    /// Sets the library of other hobs' pots for every device; returns `false` if it has not changed.
    pub fn use_library(&self, library: Library) -> bool {
        self.learner
            .get()
            .is_some_and(|learner| learner.use_library(library))
    }

    /// Checks a lookup from the fleet against the hob's own windows.
    pub fn check_lookup(&self, device: &str, lookup: &RlLookup) -> LookupCheck {
        let Some(learner) = self.learner.get() else {
            return LookupCheck::Unavailable;
        };
        match learner.contradiction(device, lookup) {
            Ok(None) => LookupCheck::Agrees,
            Ok(Some(place)) => LookupCheck::Contradicts(place),
            Err(LearningInUse) => LookupCheck::Unavailable,
        }
    }

    /// Returns events of these hobs that the fleet has not acknowledged, oldest first, and the number up to which they have no others.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn due_events(
        &self,
        hobs: Vec<String>,
        limit: usize,
    ) -> Result<(Vec<(i64, EventRow)>, i64), StoreThreadError> {
        self.in_store(move |store| store.due_events(Some(&hobs), limit))
            .await
    }

    /// Records that the fleet has acknowledged the events of each hob up to a number, or, with `all`, of every hob.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn mark_events_sent(
        &self,
        sent: Vec<(String, i64)>,
        all: Option<i64>,
    ) -> Result<(), StoreThreadError> {
        self.in_store(move |store| store.mark_events_sent(&sent, all))
            .await
    }

    /// Updates the lookup from a worker's answer if its window was sent, is in the store and confirms it; otherwise from the window itself.
    /// The result is stored, and the lookup is pushed if it has changed. Once this has returned, the result is committed.
    ///
    /// # Errors
    /// [`ReceiveError`]; the call can be repeated.
    pub async fn receive(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
        answer: WorkerAnswer,
    ) -> Result<ReceiveOutcome, ReceiveError> {
        let Some(handle) = self.devices.get(device) else {
            return Ok(ReceiveOutcome::Foreign);
        };
        let address = handle.record.address.clone();
        let sent_window = match self.sent_window(device, address, boot, seq).await? {
            Ok(sent_window) => sent_window,
            Err(received) => return Ok(received),
        };
        let learner = self.learner.get().ok_or(ReceiveError::NoRoom)?;
        if !learner.has_device(device) {
            // Not connected since the daemon started: its stored learning is restored first.
            let device_id = sent_window.device_id;
            let (learned, present) = self
                .in_store(move |store| {
                    Ok((store.learner_state(device_id)?, store.last_boot(device_id)?))
                })
                .await?;
            if !learner.has_device(device) {
                if let Err(why) = learner.add(device, learned.as_deref()) {
                    tracing::warn!(device, %why, "what was learned is lost");
                }
                learner.begin_boot(device, present.unwrap_or(boot));
            }
        }
        let (stored, is_stored) = oneshot::channel();
        learner.offer(LearnJob {
            device: device.to_owned(),
            device_id: sent_window.device_id,
            session: sent_window.session,
            boot,
            power_w: power_w(&sent_window.window.segment()),
            input: LearnInput::Answered(sent_window.window, Box::new(answer)),
            truth: None,
            stored: Some(stored),
        });
        drop(learner);
        is_stored.await.map_err(|_| ReceiveError::NoRoom)?;
        let name = device.to_owned();
        self.in_store(move |store| store.mark_answered(&name, boot, seq))
            .await?;
        Ok(ReceiveOutcome::Stored)
    }

    /// Returns the window of an answer if it was sent to the fleet and has no result yet.
    async fn sent_window(
        &self,
        device: &str,
        address: String,
        boot: u32,
        seq: u32,
    ) -> Result<Result<SentWindow, ReceiveOutcome>, ReceiveError> {
        let name = device.to_owned();
        let sent_window = self.in_store(move |store| {
            if store.has_result(&name, boot, seq)? {
                store.mark_answered(&name, boot, seq)?;
                return Ok(Err(ReceiveOutcome::Duplicate));
            }
            let Some(session) = store.session_of_boot(&name, boot)? else {
                return Ok(Err(ReceiveOutcome::Foreign));
            };
            match store.fleet_state(&name, boot, seq)? {
                Some(FleetState::Due) => return Ok(Ok(None)),
                Some(FleetState::Answered | FleetState::LearnedHere) => {
                    return Ok(Err(ReceiveOutcome::Duplicate));
                }
                Some(FleetState::NotForFleet) | None => {
                    return Ok(Err(ReceiveOutcome::Unrequested));
                }
                Some(FleetState::GivenUp(GiveUpReason::NoSamples)) => {
                    return Ok(Err(ReceiveOutcome::TooLate));
                }
                // A window given up by the fleet may have been replayed.
                Some(FleetState::Sent | FleetState::GivenUp(GiveUpReason::Dead)) => {}
            }
            let Some(window) = store.stored_window(&name, boot, seq)? else {
                return Ok(Err(ReceiveOutcome::TooLate));
            };
            Ok(Ok(Some(SentWindow {
                device_id: store.device(&name, &address)?,
                session,
                window: Box::new(window),
            })))
        });
        match sent_window.await? {
            Ok(sent_window) => sent_window.map(Ok).ok_or(ReceiveError::NotSent),
            Err(received) => Ok(Err(received)),
        }
    }

    /// Returns the records of the fleet's workers, by name: numbers of confirmed and refuted answers.
    pub fn workers(&self) -> BTreeMap<String, WorkerFigures> {
        self.learner
            .get()
            .map(|learner| learner.workers())
            .unwrap_or_default()
    }

    /// Returns the names of workers of whose answers too many were refuted.
    pub fn distrusted(&self) -> Vec<String> {
        let workers = self.workers().into_iter();
        let distrusted = workers.filter(|(_, figures)| figures.is_distrusted());
        distrusted.map(|(name, _)| name).collect()
    }
}
