//! Captures: coil voltage and current over time, from whatever recorded them, and the log of what a
//! device sent.

pub mod channels;
pub mod error;
pub mod exports;
pub mod format;
pub mod formats;
pub mod mcap;
pub mod open;
pub mod pair;

pub use error::CaptureError;
pub use format::write;
pub use open::{OpenOptions, open};
