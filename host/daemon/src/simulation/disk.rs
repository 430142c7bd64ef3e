//! A disk that is slow, or full.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use ihd_store::Store;

/// State of the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DiskState {
    /// Time that each job waits for it.
    pub delay: Duration,
    /// No result, lookup or event can be written.
    pub refuses_records: bool,
    /// No window can be written.
    pub refuses_windows: bool,
}

/// The simulated disk.
#[derive(Default)]
pub struct Disk(Mutex<DiskState>);

impl Disk {
    /// Puts it into a state.
    pub fn set(&self, state: DiskState) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }

    /// Its state now.
    pub fn state(&self) -> DiskState {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for as long as it takes now.
    pub async fn wait(&self) {
        tokio::time::sleep(self.state().delay).await;
    }

    /// Lets the store write, or not.
    pub fn apply_to(&self, store: &Store) {
        let state = self.state();
        store.refuse_writes(state.refuses_records, state.refuses_windows);
    }
}
