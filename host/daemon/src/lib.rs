//! The daemon: devices that come and go, windows that are stored and learned from, lookups that are pushed,
//! and one who commands.
//!
//! ```text
//!  Daemon (daemon.rs) ── orders ──► a task a device (device/) ── AsyncClient ──► device
//!     │                                 │ windows
//!     │ watch, reports (board, face)    ▼
//!     └──────────────────────── store_thread.rs ──► learner ──► lookups, pushed by the device's task
//! ```
//!
//! It heats nothing by itself. Power that was asked for through it belongs to one lease ([`lease`]), and ends
//! with it.

mod auditor;
pub mod board;
mod clocks;
pub mod config;
pub mod daemon;
mod device;
mod face;
mod figures;
pub mod firmware;
pub mod fleet;
mod fleet_view;
mod history;
mod hob;
mod journalist;
pub mod learning;
pub mod lease;
mod ledger;
pub mod live;
mod looks;
mod machine;
pub mod model;
mod pot_watch;
mod printable;
pub mod recording;
mod routing;
#[cfg(any(test, feature = "simulation"))]
pub mod simulation;
mod states;
mod store_health;
mod store_queue;
mod store_thread;
mod store_watch;
mod supervisor;
mod switching_off;
mod tank;

use std::sync::Arc;

use ihd_link::{LinkError, Transport};
use ihd_signal::truth::Truth;

pub use config::Config;
pub use daemon::{Daemon, DaemonError};
pub use figures::Figures;
pub use hob::hob;
pub use ihd_store::JournalFilter;
pub use live::LiveTap;
pub use store_health::cause_of;
pub use store_thread::StoreTrouble;

/// The truth of a half-cycle that is over and not too long ago, counted as the device counts them. It may wait for
/// the simulation, a moment.
pub type TruthOf = dyn Fn(u32) -> Option<Truth> + Send + Sync;

/// A device that was opened.
pub struct Opened {
    /// The way to it.
    pub transport: Box<dyn Transport>,
    /// What R and L truly are, where whoever opened it simulates it.
    pub truth: Option<Arc<TruthOf>>,
}

impl Opened {
    /// A device whose truth nobody knows.
    pub fn real(transport: Box<dyn Transport>) -> Self {
        Self {
            transport,
            truth: None,
        }
    }
}

/// Opens an address: whoever brings it may know a simulator. It may block; it runs on a thread of the link.
pub type OpenDevice = dyn Fn(&config::Address) -> Result<Opened, LinkError> + Send + Sync;
