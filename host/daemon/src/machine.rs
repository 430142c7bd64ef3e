//! The machine that the daemon runs on: its clock, and where work runs that blocks.
//!
//! A simulated machine has no threads. Store, links and learner are then tasks of the one runtime, on its paused clock, so that one seed
//! gives one course of events (simulation/).

use std::sync::Arc;

use ihd_link::{AsyncClient, Event, LinkError, Transport};
use ihd_store::clock::{Clock, of_the_machine};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

#[cfg(test)]
use crate::simulation::Disk;

/// The machine.
#[derive(Clone)]
pub struct Machine {
    clock: Clock,
    #[cfg(test)]
    disk: Option<Arc<Disk>>,
}

impl Default for Machine {
    /// The one that this process runs on.
    fn default() -> Self {
        Self {
            clock: of_the_machine(),
            #[cfg(test)]
            disk: None,
        }
    }
}

impl Machine {
    /// A machine without threads, with this clock and this disk.
    #[cfg(test)]
    pub fn simulated(clock: Clock, disk: Arc<Disk>) -> Self {
        Self {
            clock,
            disk: Some(disk),
        }
    }

    /// The simulated disk, where the machine is simulated.
    #[cfg(test)]
    pub fn disk(&self) -> Option<&Arc<Disk>> {
        self.disk.as_ref()
    }

    /// Milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        (self.clock)()
    }

    /// The clock, for the store.
    pub fn clock(&self) -> Clock {
        Arc::clone(&self.clock)
    }

    /// Runs work that takes its time.
    pub fn spawn_blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> JoinHandle<T> {
        #[cfg(test)]
        if self.disk.is_some() {
            return tokio::spawn(async move { work() });
        }
        tokio::task::spawn_blocking(work)
    }

    /// Opens a transport and shakes hands with the device behind it.
    ///
    /// # Errors
    /// As [`AsyncClient::connect`].
    pub async fn connect(
        &self,
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<Event>,
    ) -> Result<AsyncClient, LinkError> {
        #[cfg(test)]
        if self.disk.is_some() {
            return AsyncClient::connect_simulated(open, events).await;
        }
        AsyncClient::connect(open, events).await
    }
}
