//! The machine that the daemon runs on: its clock, and where work runs that blocks.
//!
//! A simulated machine has no threads. Store, links and learner are then tasks of the one runtime, on its paused clock, so that one seed
//! gives one course of events (simulation/).

use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_link::{AsyncClient, Event, LinkError, Transport};
use ihd_store::clock::{Clock, of_the_machine};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

#[cfg(any(test, feature = "simulation"))]
use crate::simulation::Disk;

/// The machine.
#[derive(Clone)]
pub struct Machine {
    clock: Clock,
    began: Instant,
    #[cfg(any(test, feature = "simulation"))]
    simulated: Option<Simulated>,
}

/// Parts of a simulated machine.
#[cfg(any(test, feature = "simulation"))]
#[derive(Clone)]
struct Simulated {
    disk: Arc<Disk>,
    began: tokio::time::Instant,
}

impl Default for Machine {
    /// The one that this process runs on.
    fn default() -> Self {
        Self {
            clock: of_the_machine(),
            began: Instant::now(),
            #[cfg(any(test, feature = "simulation"))]
            simulated: None,
        }
    }
}

impl Machine {
    /// A machine without threads, with this clock and this disk, on the runtime that calls.
    #[cfg(any(test, feature = "simulation"))]
    pub fn simulated(clock: Clock, disk: Arc<Disk>) -> Self {
        Self {
            clock,
            began: Instant::now(),
            simulated: Some(Simulated {
                disk,
                began: tokio::time::Instant::now(),
            }),
        }
    }

    /// The simulated disk, where the machine is simulated.
    #[cfg(any(test, feature = "simulation"))]
    pub fn disk(&self) -> Option<&Arc<Disk>> {
        self.simulated.as_ref().map(|simulated| &simulated.disk)
    }

    /// Milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        (self.clock)()
    }

    /// Time for which it was awake since the daemon began.
    pub fn uptime(&self) -> Duration {
        #[cfg(any(test, feature = "simulation"))]
        if let Some(simulated) = &self.simulated {
            return simulated.began.elapsed();
        }
        self.began.elapsed()
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
        #[cfg(any(test, feature = "simulation"))]
        if self.simulated.is_some() {
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
        #[cfg(any(test, feature = "simulation"))]
        if self.simulated.is_some() {
            return AsyncClient::connect_simulated(open, events).await;
        }
        AsyncClient::connect(open, events).await
    }
}
