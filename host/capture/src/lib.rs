//! Captures, coil voltage and current over time, and recordings of devices: reading, conversion and writing of their files.
//!
//! ```text
//!  file of a scope or program ──► formats ──► channels (voltage, current) ──► open ──► Capture
//!  capture file, recording    ──► mcap ────────────────────────────────────────┘        │
//!                                             CSV, NPZ, Parquet, MCAP ◄── exports ◄─────┘
//! ```
//!
//! [`format`](mod@format) is the table of all formats.

mod assembly;
pub mod channels;
pub mod error;
pub mod exports;
pub mod format;
pub mod formats;
pub mod lone;
pub mod mcap;
pub mod open;
pub mod options;
pub mod pair;
pub mod parts;
pub mod recording;

pub use error::CaptureError;
pub use format::write;
pub use open::open;
pub use options::OpenOptions;
pub use parts::PartReader;
