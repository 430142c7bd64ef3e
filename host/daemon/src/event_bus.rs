//! Publication of events to all subscribers.

use std::sync::Arc;

use ihd_model::{DaemonEvent, EventKind};
use tokio::sync::broadcast;

use crate::machine::Machine;

/// Events that a slow subscriber may lag behind before it misses some: some seconds of 32 devices.
const CAPACITY: usize = 4_096;

/// Broadcast channel of events; cheap to clone.
#[derive(Clone)]
pub struct EventBus {
    events: broadcast::Sender<Arc<DaemonEvent>>,
    machine: Machine,
}

impl Default for EventBus {
    fn default() -> Self {
        Self::new(Machine::default())
    }
}

impl EventBus {
    /// Creates a bus that stamps events with the clock of `machine`.
    pub fn new(machine: Machine) -> Self {
        Self {
            events: broadcast::channel(CAPACITY).0,
            machine,
        }
    }

    /// Publishes an event to all subscribers; `device` is empty for events of the daemon.
    pub fn publish(&self, device: &str, kind: EventKind) {
        // Fails only without subscribers.
        let _ = self.events.send(Arc::new(DaemonEvent {
            at_ms: self.now_ms(),
            device: device.to_owned(),
            kind,
        }));
    }

    /// Returns milliseconds since 1970, UTC, on the machine's clock.
    pub fn now_ms(&self) -> i64 {
        self.machine.now_ms()
    }

    /// Subscribes to all events from now on.
    pub fn subscribe(&self) -> broadcast::Receiver<Arc<DaemonEvent>> {
        self.events.subscribe()
    }
}
