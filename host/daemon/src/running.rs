//! Running parts of the daemon, and the order in which they end.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::auditor::Auditor;
use crate::history::{self, TelemetryBuffer};
use crate::learning::LearnerSlot;
use crate::locking::lock;
use crate::machine::Machine;
use crate::store_thread::StoreThread;
use crate::supervisor::Devices;

/// Time limit at the stop for the learner's fits under way.
const LEARNER_TIMEOUT: Duration = Duration::from_secs(10);

/// Running parts of the daemon.
pub struct Running {
    pub machine: Machine,
    pub devices: Arc<Devices>,
    pub auditor: Arc<Auditor>,
    /// Telemetry that is not stored yet.
    pub telemetry: Arc<TelemetryBuffer>,
    pub store: StoreThread,
    pub learner: LearnerSlot,
    /// Task that routes the learner's results; `None` once the daemon stops.
    pub routing: Mutex<Option<JoinHandle<()>>>,
    pub stop: watch::Sender<bool>,
}

impl Running {
    /// Switches off the power requested through the daemon, stores pending data, closes the store.
    pub async fn stop(&self) {
        self.stop.send_replace(true);
        self.devices.join().await;
        self.auditor.close().await;
        let now_ms = self.machine.now_ms();
        history::write(&self.telemetry, &self.store, now_ms, true).await;
        // Store jobs of windows hold the learner.
        self.store.idle().await;
        self.learner.clear();
        let routing = lock(&self.routing).take();
        if let Some(routing) = routing {
            // Ends once the learner's threads have finished their fits.
            let _ = tokio::time::timeout(LEARNER_TIMEOUT, routing).await;
        }
        self.store.close().await;
    }
}
