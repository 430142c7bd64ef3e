//! What the daemon keeps: windows, results, lookups, what was learned, events and commands.
//!
//! ```text
//!  ihd-store/
//!    ihd.db                    devices, sessions, results, lookups, learned, events, audit: FULL
//!    windows-2026-11-22.db     that day's windows, bit for bit: NORMAL; retention thins and deletes them
//!    ihd.lock                  held by the one process that writes
//!    ihd.db.damaged-…          set aside at a start, never read again
//! ```
//!
//! [`Store`] writes, and is one process's; [`Reader`] reads beside it. What a method has returned `Ok` for is
//! committed. docs/store.md has the tables, queries and what to do with a damaged file.

mod age;
mod backup;
pub mod check;
pub mod clock;
mod curves;
mod database;
mod error;
pub mod export;
mod fleet_state;
mod fleet_tally;
pub mod folder;
mod journal;
mod lookups;
mod outbox;
mod payload;
mod reader;
mod recent;
mod results;
mod retention;
mod room;
pub mod schema;
mod settings;
mod space;
mod start;
mod store;
mod telemetry;
mod text;
mod thinning;
mod trial;
mod windows;

pub use backup::backup;
pub use curves::{Curve, CurveOf, Curves, MAX_POINTS};
pub use error::StoreError;
pub use fleet_state::{FleetMark, FleetState, GivenUp, Sent};
pub use fleet_tally::FleetTally;
pub use folder::Damage;
pub use ihd_signal::atomic;
pub use journal::{AuditRow, EventRow, JournalFilter, JournalRow, NewEvent};
pub use lookups::{Confidence, LookupRow, LookupState};
pub use outbox::{Due, DueWindow};
pub use reader::{DeviceRow, Reader, SessionRow};
pub use results::{NewResult, ResultFilter, ResultRow, Taught};
pub use retention::Collected;
pub use settings::{Keep, Retention, Settings, UnknownKeep};
pub use space::{DaySpace, bytes_a_day};
pub use start::Opened;
pub use store::{Figures, Store};
pub use telemetry::{Spread, TelemetryRead, TelemetrySecond, TelemetrySpan};
pub use trial::{Tried, try_folder};
pub use windows::{Kept, WindowFilter, WindowRow};

/// A device in the store.
pub type DeviceId = i64;

/// A connection in the store.
pub type SessionId = i64;

/// A result in the store.
pub type ResultId = i64;
