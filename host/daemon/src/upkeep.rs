//! Upkeep: figures of operation, the store's response, damage, backup.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ihd_store::ResultFilter;
use tokio::time::Instant;

use crate::auditor::Auditor;
use crate::error::DaemonError;
use crate::figures::{DaemonFigures, rss_bytes};
use crate::learning::LearnerSlot;
use crate::store_thread::{StoreThread, StoreThreadError};
use crate::supervisor::Devices;

/// Longest response time of a store that counts as alive.
const STORE_TIMEOUT: Duration = Duration::from_secs(5);

/// Access for whoever keeps the daemon running.
pub struct Upkeep {
    pub(crate) devices: Arc<Devices>,
    pub(crate) store: StoreThread,
    pub(crate) learner: LearnerSlot,
    pub(crate) auditor: Arc<Auditor>,
    /// Folder of the store.
    pub(crate) folder: PathBuf,
    pub(crate) began: Instant,
    /// Damaged files set aside at the start, as text.
    pub(crate) damage: Vec<String>,
}

impl Upkeep {
    /// Returns the figures of the daemon.
    pub fn figures(&self) -> DaemonFigures {
        let learner = self.learner.get();
        DaemonFigures {
            learner: learner.map(|l| l.figures()).unwrap_or_default(),
            devices: self.devices.all().len(),
            up_s: self.began.elapsed().as_secs_f64(),
            rss_bytes: rss_bytes(),
            audit_is_healthy: self.auditor.is_healthy(),
            audits_lost: self.auditor.lost(),
            ..DaemonFigures::from_store(&self.store)
        }
    }

    /// Returns `true` if the store responds in time, even with an error.
    pub async fn store_responds(&self) -> bool {
        let one = ResultFilter {
            limit: Some(1),
            ..ResultFilter::default()
        };
        let query = self.store.run(move |store| store.results(&one));
        tokio::time::timeout(STORE_TIMEOUT, query).await.is_ok()
    }

    /// Returns `true` if the store's thread goes on with its jobs, even if each of them waits for a locked database and fails.
    pub fn store_progresses(&self) -> bool {
        self.store.progresses()
    }

    /// Returns the files of the store that were damaged at the start and set aside, as text.
    pub fn damage(&self) -> &[String] {
        &self.damage
    }

    /// Copies the store while it is in use.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn backup(&self, to: PathBuf) -> Result<(), DaemonError> {
        // Not on the store's thread, which would delay windows.
        let from = self.folder.clone();
        let backup = tokio::task::spawn_blocking(move || ihd_store::backup(&from, &to)).await;
        Ok(backup.map_err(|_| StoreThreadError::Gone("the backup panicked"))??)
    }
}
