//! The daemon: connects to devices, stores their windows, learns from them, pushes lookups and carries out commands.
//!
//! ```text
//!  Daemon (daemon.rs) ── requests ──► one task per device (device/) ── AsyncClient ──► device
//!     │                                   │ windows
//!     │ events, reports                   ▼
//!     │ (event_bus.rs, device_record.rs)  store_thread.rs ──► learner ──► lookups, pushed by the device's task
//! ```
//!
//! The daemon never heats by itself. Power requested through it belongs to one lease ([`lease`]) and ends with it.

mod auditor;
mod clocks;
mod commander;
pub mod config;
mod context;
pub mod daemon;
mod device;
mod device_record;
mod error;
pub mod event_bus;
mod event_log;
mod figures;
pub mod firmware;
pub mod fleet;
mod fleet_view;
mod history;
mod hob;
pub mod learning;
pub mod lease;
pub mod live;
pub mod locking;
mod machine;
mod pot_tracker;
mod printable;
pub mod private_file;
pub mod recording;
mod result_route;
mod running;
#[cfg(any(test, feature = "simulation"))]
pub mod simulation;
pub mod states;
mod store_health;
mod store_queue;
mod store_thread;
mod store_watch;
mod supervisor;
mod switching_off;
mod tank;
mod upkeep;
mod view;
mod window_accounting;

use std::sync::Arc;

use ihd_link::{LinkError, Transport};
use ihd_signal::truth::Truth;

pub use config::DaemonConfig;
pub use daemon::Daemon;
pub use error::DaemonError;
pub use figures::DaemonFigures;
pub use history::MAX_COLUMNS;
pub use hob::hob;
pub use ihd_store::JournalFilter;
pub use lease::LEASE_S;
pub use live::LiveTap;
pub use store_health::cause_of;
pub use store_thread::StoreThreadError;
pub use upkeep::Upkeep;
pub use view::{Recordings, View};

/// Source of the true R and L of a recent half-cycle, by the device's half-cycle count; does not wait for the simulation.
pub type TruthFn = dyn Fn(u32) -> Option<Truth> + Send + Sync;

/// Opened device: its transport and, if simulated, its true R and L.
pub struct OpenedDevice {
    /// Transport to the device.
    pub transport: Box<dyn Transport>,
    /// True R and L; `None` unless the device is simulated.
    pub truth: Option<Arc<TruthFn>>,
}

impl OpenedDevice {
    /// Returns a device without a known truth.
    pub fn real(transport: Box<dyn Transport>) -> Self {
        Self {
            transport,
            truth: None,
        }
    }
}

/// Function that opens an address, possibly of a simulator. It may block; it runs on a thread of the link.
pub type OpenDevice = dyn Fn(&config::Address) -> Result<OpenedDevice, LinkError> + Send + Sync;
