//! The machine that the daemon runs on: clock, threads and connections.
//!
//! A simulated machine has no threads: store, links and learner are tasks of one runtime on a paused clock, so that a seed determines
//! the course of events (simulation/).

use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_link::{AsyncClient, DeviceEvent, LinkError, Transport};
use ihd_store::clock::{Clock, of_the_machine};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

#[cfg(any(test, feature = "simulation"))]
use crate::simulation::disk::SimulatedDisk;

/// Real or simulated machine; cheap to clone.
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
    disk: Arc<SimulatedDisk>,
    began: tokio::time::Instant,
}

impl Default for Machine {
    /// Returns the real machine.
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
    /// Returns a machine without threads, on the calling runtime.
    #[cfg(any(test, feature = "simulation"))]
    pub fn simulated(clock: Clock, disk: Arc<SimulatedDisk>) -> Self {
        Self {
            clock,
            began: Instant::now(),
            simulated: Some(Simulated {
                disk,
                began: tokio::time::Instant::now(),
            }),
        }
    }

    /// Returns the simulated disk; `None` on a real machine.
    #[cfg(any(test, feature = "simulation"))]
    pub fn disk(&self) -> Option<&Arc<SimulatedDisk>> {
        self.simulated.as_ref().map(|simulated| &simulated.disk)
    }

    /// Returns milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        (self.clock)()
    }

    /// Returns the time for which the machine was awake since the start of the daemon. On some systems suspend counts, too.
    pub fn awake(&self) -> Duration {
        #[cfg(any(test, feature = "simulation"))]
        if let Some(simulated) = &self.simulated {
            return simulated.began.elapsed();
        }
        self.began.elapsed()
    }

    /// Returns the time since a fixed instant, with suspend. A simulated machine is never suspended.
    pub fn elapsed(&self) -> Duration {
        #[cfg(any(test, feature = "simulation"))]
        if self.simulated.is_some() {
            return self.awake();
        }
        #[cfg(target_os = "linux")]
        if let Ok(time) = nix::time::ClockId::CLOCK_BOOTTIME.now() {
            return time.into();
        }
        // The other systems have no such clock in common but the wall's, which may also be set.
        Duration::from_millis(self.now_ms().unsigned_abs())
    }

    /// Returns the wall clock, for the store.
    pub fn clock(&self) -> Clock {
        Arc::clone(&self.clock)
    }

    /// Runs blocking work on a thread for it; on a simulated machine as a task.
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

    /// Opens a transport and performs the handshake with the device.
    ///
    /// # Errors
    /// As [`AsyncClient::connect`].
    pub async fn connect(
        &self,
        open: impl FnOnce() -> Result<Box<dyn Transport>, LinkError> + Send + 'static,
        events: mpsc::Sender<DeviceEvent>,
    ) -> Result<AsyncClient, LinkError> {
        #[cfg(any(test, feature = "simulation"))]
        if self.simulated.is_some() {
            return AsyncClient::connect_simulated(open, events).await;
        }
        AsyncClient::connect(open, events).await
    }
}
