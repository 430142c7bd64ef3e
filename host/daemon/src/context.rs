//! Services of the daemon that its tasks share.

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::watch;

use crate::OpenDevice;
use crate::fleet::delegation::Delegation;
use crate::history::telemetry_buffer::TelemetryBuffer;
use crate::learning::Learner;
use crate::machine::Machine;
use crate::store_thread::StoreThread;

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
    /// Returns at the stop signal.
    pub async fn stopping(&self) {
        // An error means that the daemon is gone.
        let _ = self.stop.clone().wait_for(|&stopping| stopping).await;
    }
}
