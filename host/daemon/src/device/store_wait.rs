//! Waits of a device's task for the store, with one limit for all of a step.

use std::sync::Mutex;
use std::time::Duration;

use ihd_model::RecordKind;
use ihd_store::{Store, StoreError};
use tokio::time::Instant;

use crate::locking::lock;
use crate::store_thread::StoreThread;

/// Longest wait for the store at the begin of a session and at its end, when the device does not heat for the daemon.
const IDLE_LIMIT: Duration = Duration::from_secs(4);

/// Longest wait for the store in one step of a session, which delays keep-alive (every 2 s) and the end of a lease (10 s).
const STEP_LIMIT: Duration = Duration::from_secs(1);

/// Wait of one device's task for the store, because a device must not wait for a disk.
pub struct StoreWait {
    store: StoreThread,
    /// Rest of the present step's limit.
    left: Mutex<Duration>,
}

impl StoreWait {
    /// Begins with the session.
    pub fn new(store: StoreThread) -> Self {
        Self {
            store,
            left: Mutex::new(IDLE_LIMIT),
        }
    }

    /// Begins a step of the session.
    pub fn begin_step(&self) {
        *lock(&self.left) = STEP_LIMIT;
    }

    /// Begins the end of the session.
    pub fn begin_end(&self) {
        *lock(&self.left) = IDLE_LIMIT;
    }

    /// Returns `true` if this step has no time left for the store.
    pub fn is_over(&self) -> bool {
        lock(&self.left).is_zero()
    }

    /// Runs `f` with the store. Returns `None` after an error, which the store's thread reports, and if it is not done within the
    /// limit; then it is done later.
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Option<T> {
        let (left, began) = (*lock(&self.left), Instant::now());
        let store = self.store.writing(RecordKind::State);
        let done = tokio::time::timeout(left, store.run(f)).await;
        *lock(&self.left) = left.saturating_sub(began.elapsed());
        done.ok()?.ok()
    }
}
