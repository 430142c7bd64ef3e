//! Files of the daemon's recordings ([`ihd_capture::recording`]): names, list, export as tables.

mod files;
mod tables;

pub use files::{file_name, free_bytes, is_plain_name, list};
pub use ihd_capture::exports::recording::RecordingExportError;
pub use tables::{EXPORT_TIMEOUT, RecordingTable, table};
