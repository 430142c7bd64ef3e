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

pub mod board;
mod clocks;
pub mod config;
pub mod daemon;
mod device;
mod face;
mod figures;
pub mod learning;
pub mod lease;
mod ledger;
pub mod model;
mod printable;
mod routing;
mod states;
mod store_thread;
mod supervisor;

use ihd_link::{LinkError, Transport};

pub use config::Config;
pub use daemon::{Daemon, DaemonError};
pub use figures::Figures;
pub use store_thread::StoreTrouble;

/// Opens the transport to an address: whoever brings it may know a simulator. It may block; it runs on a
/// thread of the link.
pub type OpenDevice =
    dyn Fn(&config::Address) -> Result<Box<dyn Transport>, LinkError> + Send + Sync;
