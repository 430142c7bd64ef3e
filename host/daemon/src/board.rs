//! Where everybody who watches hears what happens.

use std::sync::Arc;

use tokio::sync::broadcast;

use crate::machine::Machine;
use crate::model::{Notice, What};

/// Notices that a slow watcher may be behind before it misses some: some seconds of 32 devices.
const BEHIND: usize = 4_096;

/// The way of notices to whoever watches.
#[derive(Clone)]
pub struct Board {
    notices: broadcast::Sender<Arc<Notice>>,
    machine: Machine,
}

impl Default for Board {
    fn default() -> Self {
        Self::new(Machine::default())
    }
}

impl Board {
    /// One whose notices bear the time of this machine.
    pub fn new(machine: Machine) -> Self {
        Self {
            notices: broadcast::channel(BEHIND).0,
            machine,
        }
    }

    /// Tells whoever watches; `device` is empty where the daemon itself speaks.
    pub fn tell(&self, device: &str, what: What) {
        // Nobody needs to watch.
        let _ = self.notices.send(Arc::new(Notice {
            at_ms: self.now_ms(),
            device: device.to_owned(),
            what,
        }));
    }

    /// Milliseconds since 1970, UTC, on the machine's clock.
    pub fn now_ms(&self) -> i64 {
        self.machine.now_ms()
    }

    /// All notices from now on.
    pub fn watch(&self) -> broadcast::Receiver<Arc<Notice>> {
        self.notices.subscribe()
    }
}

/// Milliseconds since 1970, UTC.
pub fn now_ms() -> i64 {
    jiff::Timestamp::now().as_millisecond()
}
