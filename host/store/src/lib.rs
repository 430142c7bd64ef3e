//! The daemon's store in SQLite: windows, results, lookups, the learner's state, events and commands.
//!
//! ```text
//!  ihd-store/
//!    ihd.db                    devices, sessions, results, lookups, learned, events, audit: FULL
//!    windows-2026-11-22.db     that day's windows, bit for bit: NORMAL; retention thins and deletes them
//!    ihd.lock                  held by the one process that writes
//!    ihd.db.damaged-…          set aside at a start, never read again
//! ```
//!
//! [`Store`] writes; one process holds it. [`StoreReader`] reads at the same time. When a method has returned `Ok`, its change is committed.
//! docs/daemon.md has the tables, queries and what to do with a damaged file.

mod age;
mod backup;
pub mod check;
pub mod clock;
mod curves;
mod database;
mod due_window;
mod error;
pub mod export;
mod fleet_state;
mod fleet_tally;
pub mod folder;
mod journal;
mod lookups;
mod options;
mod outbox;
mod payload;
mod reader;
mod recent;
mod results;
mod retention;
mod room;
mod schema;
mod space;
mod start;
mod store;
mod telemetry;
mod text;
mod thinning;
mod trial;
mod windows;

pub use backup::backup;
pub use curves::{CurveSource, Curves, MAX_POINTS, StoredCurve};
pub use due_window::DueWindow;
pub use error::StoreError;
pub use fleet_state::{DeliveryState, FleetMark, FleetState, GiveUpReason};
pub use folder::DamagedFile;
pub use ihd_signal::atomic;
pub use journal::{AuditRow, EventRow, JournalFilter, JournalRow, NewEvent};
pub use lookups::{Certainty, LookupRow, LookupState, superseded_lookups};
pub use options::{Retention, SamplePolicy, StoreOptions, UnknownSamplePolicy};
pub use outbox::OutboxItem;
pub use reader::{DeviceRow, SessionRow, StoreReader};
pub use results::{LastAccepted, NewResult, ResultFilter, ResultRow};
pub use retention::CollectionReport;
pub use space::{DaySpace, bytes_a_day};
pub use start::OpenedStore;
pub use store::{Store, StoreFigures};
pub use telemetry::{Spread, TelemetryRead, TelemetrySecond, TelemetrySpan};
pub use trial::{TrialReport, try_folder};
pub use windows::{InsertOutcome, WindowFilter, WindowRow};

/// A device in the store.
pub type DeviceId = i64;

/// A connection in the store.
pub type SessionId = i64;

/// A result in the store.
pub type ResultId = i64;
