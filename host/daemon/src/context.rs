//! Services of the daemon that its tasks share.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ihd_model::RecordKind;
use ihd_store::{Store, StoreError};
use tokio::sync::watch;

use crate::OpenDevice;
use crate::fleet::delegation::Delegation;
use crate::history::telemetry_buffer::TelemetryBuffer;
use crate::learning::Learner;
use crate::machine::Machine;
use crate::store_thread::StoreThread;

/// Time limit for a store job of a device's task.
const STORE_TIMEOUT: Duration = Duration::from_secs(4);

/// Services of the daemon that its tasks share; cheap to clone.
#[derive(Clone)]
pub struct Context {
    /// Machine that the daemon runs on.
    pub machine: Machine,
    /// Thread of the store.
    pub store: StoreThread,
    /// Telemetry that is not stored yet.
    pub telemetry: Arc<TelemetryBuffer>,
    /// Learner, which fits windows.
    pub learner: Arc<Learner>,
    /// Function that opens an address.
    pub open: Arc<OpenDevice>,
    /// Delegation of learning to a fleet.
    pub delegation: Arc<Delegation>,
    /// Folder of recordings.
    pub recordings: PathBuf,
    /// Stop signal: `true` once the daemon stops or the board is unplugged.
    pub stop: watch::Receiver<bool>,
}

impl Context {
    /// Runs `f` with the store. Returns `None` after an error, which the store's thread reports, and after
    /// `STORE_TIMEOUT`, because a device must not wait for a disk.
    pub async fn in_store<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Option<T> {
        let store = self.store.writing(RecordKind::State);
        let done = tokio::time::timeout(STORE_TIMEOUT, store.run(f)).await;
        done.ok()?.ok()
    }

    /// Returns at the stop signal.
    pub async fn stopping(&self) {
        // An error means that the daemon is gone.
        let _ = self.stop.clone().wait_for(|&stopping| stopping).await;
    }
}
