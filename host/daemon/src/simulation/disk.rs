//! Simulated disk: slow, or full.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use ihd_store::Store;

/// State of the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DiskState {
    /// Delay of each job.
    pub delay: Duration,
    /// `true` while no result, lookup or event can be written.
    pub refuses_records: bool,
    /// `true` while no window can be written.
    pub refuses_windows: bool,
}

/// Simulated disk.
#[derive(Default)]
pub struct SimulatedDisk(Mutex<DiskState>);

impl SimulatedDisk {
    /// Sets the state.
    pub fn set(&self, state: DiskState) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }

    /// Returns the state.
    pub fn state(&self) -> DiskState {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the current delay.
    pub async fn wait(&self) {
        tokio::time::sleep(self.state().delay).await;
    }

    /// Applies the state to a store: it accepts or refuses writes.
    pub fn apply_to(&self, store: &Store) {
        let state = self.state();
        store.refuse_writes(state.refuses_records, state.refuses_windows);
    }
}
