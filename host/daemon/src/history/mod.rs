//! Telemetry of devices by seconds: to the store, and from it to the columns of a display.
//!
//! ```text
//! session ─► TelemetryBuffer (bounded) ── every 5 s ─► store ─► Columns ─► History
//!            telemetry_buffer.rs          writer.rs             columns.rs
//!               └──────────── seconds not written yet ─────────────┘
//! ```

mod columns;
pub(crate) mod telemetry_buffer;
mod writer;

pub use columns::{ColumnGrid, Columns, MAX_COLUMNS};
pub use telemetry_buffer::TelemetryBuffer;
pub use writer::{write, write_periodically};
