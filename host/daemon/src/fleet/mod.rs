//! What a daemon that is an edge of a fleet has for whoever talks to the fleet (docs/fleet.md): what is due there, and what comes back.
//!
//! The daemon itself knows no server. While the fleet is trusted ([`Daemon::trust_fleet`]), windows that are due there are not learned from
//! here; what is found elsewhere is learned from as if it had been found here. Trust is a lease: it ends by itself.

mod config;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_link::Window;
use ihd_map::library::{Library, PotEntry, Provenance};
use ihd_shared::lookup::RlLookup;
use ihd_store::{
    DeliveryState, DeviceId, DueWindow, EventRow, FleetMark, FleetState, FleetTally, GiveUpReason,
    OutboxItem, SessionId,
};
use ihd_train::learning::Contradiction;
use tokio::sync::oneshot;
use tokio::time::Instant;

pub use self::config::{FleetConfig, host_name};
use crate::daemon::{Daemon, lock};
use crate::learning::{LearnInput, LearnJob, LearningInUse, WorkerAnswer, WorkerFigures, power_w};
use crate::printable::printable;
use crate::store_thread::StoreTrouble;

/// Duration of trust after the fleet's last answer: the longest that a result may take.
pub const TRUSTED_FOR: Duration = Duration::from_secs(20);

/// Trust in a fleet: a lease, which holds nothing once its time is over, whatever became of the task that renews it.
#[derive(Debug, Default)]
pub struct Trust {
    /// The daemon is an edge.
    pub is_edge: bool,
    until: Mutex<Option<Instant>>,
}

impl Trust {
    /// For a daemon that is an edge, or not; nothing is trusted yet.
    pub fn new(is_edge: bool) -> Self {
        Self {
            is_edge,
            until: Mutex::new(None),
        }
    }

    /// Whether windows are left to the fleet now.
    pub fn holds(&self) -> bool {
        lock(&self.until).is_some_and(|until| Instant::now() < until)
    }

    /// Holds until then, and never longer than [`TRUSTED_FOR`] from now; no more where that is none.
    fn renew(&self, until: Option<Instant>) {
        let longest = Instant::now() + TRUSTED_FOR;
        *lock(&self.until) = until.map(|until| until.min(longest));
    }
}

/// What became of something that was found elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// It is stored.
    Stored,
    /// A result of this window was stored before.
    Known,
    /// The device or its boot is not known here: it is another edge's, or from before the store.
    Foreign,
    /// The store holds no such window, or none that the fleet was to have: nobody asked for this result.
    Unasked,
}

/// Judgement of a lookup from elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Advice {
    /// The hob's windows say the same, or there are none.
    Agrees,
    /// They say otherwise.
    Contradicts(Contradiction),
    /// It cannot be told now.
    Later,
}

/// Why something that was found elsewhere is not stored; it may be tried again.
#[derive(Debug, thiserror::Error)]
pub enum ReceiveError {
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreTrouble),
    /// Others had to be learned first, and there was no room.
    #[error("there is no room in the queue of what is to be learned")]
    NoRoom,
    /// The window is here, and the fleet has not acknowledged it yet.
    #[error("the fleet has not acknowledged its window yet")]
    NotSent,
}

/// A window that the fleet was asked for.
struct Asked {
    device_id: DeviceId,
    session: SessionId,
    window: Box<Window>,
}

impl Daemon {
    /// Leaves windows to the fleet until then, [`TRUSTED_FOR`] at most; from then on, and where that is none, learns from them here.
    pub fn trust_fleet(&self, until: Option<Instant>) {
        self.trust().renew(until);
    }

    /// Whether windows are left to the fleet now.
    pub fn trusts_fleet(&self) -> bool {
        self.trust().holds()
    }

    /// The oldest windows that are due at the fleet, at most so many, without those that are being learned from here.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn due(&self, limit: usize) -> Result<Vec<DueWindow>, StoreTrouble> {
        let learner = self.learner();
        let held = learner.as_ref().map_or(0, |learner| learner.most_pending());
        let mut due = self.in_store(move |store| store.due(limit + held)).await?;
        if let Some(learner) = learner {
            due.retain(|w| !learner.is_pending(&w.device, w.boot, w.seq));
        }
        due.truncate(limit);
        Ok(due)
    }

    /// How many windows are due at the fleet.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn count_due(&self) -> Result<u64, StoreTrouble> {
        self.in_store(ihd_store::Store::count_due).await
    }

    /// What there is of a window that is due.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn read_due(&self, due: DueWindow) -> Result<OutboxItem, StoreTrouble> {
        self.in_store(move |store| store.read_due(&due)).await
    }

    /// Outcomes of windows that were due.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn sent(&self, sent: Vec<(DueWindow, DeliveryState)>) -> Result<(), StoreTrouble> {
        self.in_store(move |store| store.mark_sent(&sent)).await
    }

    /// Windows that the fleet got before a time (milliseconds since 1970, UTC) and never answered are due again. How many.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn due_again(&self, before_ms: i64) -> Result<u64, StoreTrouble> {
        self.in_store(move |store| store.requeue_unanswered(before_ms))
            .await
    }

    /// Windows that the fleet got before a time (milliseconds since 1970, UTC) and has not answered: so many behind the first `skip`.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn unanswered(
        &self,
        before_ms: i64,
        skip: usize,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreTrouble> {
        self.in_store(move |store| store.unanswered(before_ms, skip, limit))
            .await
    }

    /// The fleet has given up a window that it was sent.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn given_up(&self, window: &DueWindow, why: &str) -> Result<(), StoreTrouble> {
        let (window, why) = (window.clone(), printable(why));
        self.in_store(move |store| {
            store.mark_given_up(&window.device, window.boot, window.seq, &why)
        })
        .await
    }

    /// All windows in the store by their progress with the fleet. Day by day, so that nothing else waits for long.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn fleet_tally(&self) -> Result<FleetTally, StoreTrouble> {
        let days = self.in_store(|store| store.days_of_windows()).await?;
        let mut all = FleetTally::default();
        for day in days {
            all = all.and(self.in_store(move |store| store.fleet_tally(&day)).await?);
        }
        Ok(all)
    }

    /// Marks of the fleet's server.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn fleet_mark(&self, mark: FleetMark) -> Result<Option<i64>, StoreTrouble> {
        self.in_store(move |store| store.fleet_mark(mark)).await
    }

    /// Remembers something of the fleet's server.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn mark_fleet(&self, mark: FleetMark, value: i64) -> Result<(), StoreTrouble> {
        self.in_store(move |store| store.mark_fleet(mark, value))
            .await
    }

    /// The store's folder.
    pub fn store_folder(&self) -> &Path {
        &self.inner.folder
    }

    /// The skew in seconds that is to be taken out of the current of a device's windows, as far as they have shown it.
    pub fn skew_s(&self, device: &str) -> Option<f64> {
        self.learner()?.skew_s(device)
    }

    /// What only this daemon's store knows: by it a fleet knows what it sends.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn fleet_secret(&self) -> Result<[u8; 16], StoreTrouble> {
        self.in_store(ihd_store::Store::fleet_secret).await
    }

    /// What other hobs may learn of the pot on a device, where it is known well enough.
    pub fn pot_entry(&self, device: &str, by: Provenance) -> Option<PotEntry> {
        self.learner()?.pot_entry(device, by)
    }

    /// Pots that other hobs know, for every device to begin with; false where they are those of before.
    pub fn use_library(&self, library: Library) -> bool {
        self.learner()
            .is_some_and(|learner| learner.use_library(library))
    }

    /// Compares a lookup that somebody in the fleet wants used with what the hob's own windows showed.
    pub fn weigh_lookup(&self, device: &str, lookup: &RlLookup) -> Advice {
        let Some(learner) = self.learner() else {
            return Advice::Later;
        };
        match learner.contradiction(device, lookup) {
            Ok(None) => Advice::Agrees,
            Ok(Some(place)) => Advice::Contradicts(place),
            Err(LearningInUse) => Advice::Later,
        }
    }

    /// Events that the fleet has not acknowledged, oldest first.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn due_events(&self, limit: usize) -> Result<Vec<(i64, EventRow)>, StoreTrouble> {
        self.in_store(move |store| store.due_events(limit)).await
    }

    /// The fleet has acknowledged all events up to this number.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn events_sent(&self, up_to: i64) -> Result<(), StoreTrouble> {
        self.in_store(move |store| store.mark_events_sent(up_to))
            .await
    }

    /// Learns from a worker's answer, if the window that it answers was sent, is in the store, and confirms it; else from the window itself.
    /// The result is stored, and the lookup is pushed where it says something new. Once this has returned, the result is committed.
    ///
    /// # Errors
    /// [`ReceiveError`]; it may be tried again.
    pub async fn receive(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
        answer: WorkerAnswer,
    ) -> Result<Received, ReceiveError> {
        let Some(handle) = self.handle_of(device) else {
            return Ok(Received::Foreign);
        };
        let address = handle.face.address.clone();
        let asked = match self.asked(device, address, boot, seq).await? {
            Ok(asked) => asked,
            Err(received) => return Ok(received),
        };
        let learner = self.learner().ok_or(ReceiveError::NoRoom)?;
        if !learner.has_device(device) {
            // Not connected since the daemon began: what was learned before must not be begun anew.
            let device_id = asked.device_id;
            let learned = self
                .in_store(move |store| store.learner_state(device_id))
                .await?;
            if !learner.has_device(device)
                && let Err(why) = learner.add(device, learned.as_deref())
            {
                tracing::warn!(device, %why, "what was learned is lost");
            }
        }
        let (stored, is_stored) = oneshot::channel();
        learner.offer(LearnJob {
            device: device.to_owned(),
            device_id: asked.device_id,
            session: asked.session,
            boot,
            power_w: power_w(&asked.window.segment()),
            input: LearnInput::Answered(asked.window, Box::new(answer)),
            truth: None,
            stored: Some(stored),
        });
        drop(learner);
        is_stored.await.map_err(|_| ReceiveError::NoRoom)?;
        let name = device.to_owned();
        self.in_store(move |store| store.mark_answered(&name, boot, seq))
            .await?;
        Ok(Received::Stored)
    }

    /// The window that an answer is for, if the fleet was asked for it and nobody has answered.
    async fn asked(
        &self,
        device: &str,
        address: String,
        boot: u32,
        seq: u32,
    ) -> Result<Result<Asked, Received>, ReceiveError> {
        let name = device.to_owned();
        let asked = self.in_store(move |store| {
            if store.has_result(&name, boot, seq)? {
                store.mark_answered(&name, boot, seq)?;
                return Ok(Err(Received::Known));
            }
            let Some(session) = store.session_of_boot(&name, boot)? else {
                return Ok(Err(Received::Foreign));
            };
            match store.fleet_state(&name, boot, seq)? {
                Some(FleetState::Due) => return Ok(Ok(None)),
                Some(FleetState::Answered | FleetState::LearnedHere) => {
                    return Ok(Err(Received::Known));
                }
                Some(FleetState::NotForFleet | FleetState::GivenUp(GiveUpReason::NoSamples))
                | None => {
                    return Ok(Err(Received::Unasked));
                }
                // One that was given up there may have been replayed.
                Some(FleetState::Sent | FleetState::GivenUp(GiveUpReason::Dead)) => {}
            }
            let Some(window) = store.stored_window(&name, boot, seq)? else {
                return Ok(Err(Received::Unasked));
            };
            Ok(Ok(Some(Asked {
                device_id: store.device(&name, &address)?,
                session,
                window: Box::new(window),
            })))
        });
        match asked.await? {
            Ok(asked) => asked.map(Ok).ok_or(ReceiveError::NotSent),
            Err(received) => Ok(Err(received)),
        }
    }

    /// Records of the fleet's workers, by name: how many of their answers the windows confirm.
    pub fn workers(&self) -> BTreeMap<String, WorkerFigures> {
        self.learner()
            .map(|learner| learner.workers())
            .unwrap_or_default()
    }

    /// Names of workers whose answers were refuted too often.
    pub fn distrusted(&self) -> Vec<String> {
        let workers = self.workers().into_iter();
        let distrusted = workers.filter(|(_, figures)| figures.is_distrusted());
        distrusted.map(|(name, _)| name).collect()
    }

    fn trust(&self) -> &Arc<Trust> {
        &self.inner.trust
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn trust_ends_by_itself_and_is_never_given_for_longer() {
        let trust = Trust::new(true);
        assert!(!trust.holds());
        trust.renew(Some(Instant::now() + 100 * TRUSTED_FOR));
        assert!(trust.holds());
        tokio::time::advance(TRUSTED_FOR - Duration::from_millis(1)).await;
        assert!(trust.holds());
        tokio::time::advance(Duration::from_millis(1)).await;
        assert!(!trust.holds(), "nobody has renewed it");
        trust.renew(Some(Instant::now() + Duration::from_secs(1)));
        assert!(trust.holds());
        trust.renew(None);
        assert!(!trust.holds());
    }
}
