//! The project's capture file: MCAP (<https://mcap.dev>) with the profile `ihd-capture 1`.
//!
//! docs/captures.md describes topics and layouts for people and other tools. Bulk numbers (samples,
//! truth) are CDR messages with a `ros2msg` schema, events are JSON with a JSON schema; both carry
//! their own description, and public tools decode them.
//!
//! ```text
//!  Writer ── messages ──► chunks of zstd, each whole or absent ──► Reader ──► Capture
//!    ▲                                                               │
//!  SessionRecorder (bytes of a link, and what they mean)          SessionReader (events again)
//! ```

pub mod cdr;
mod chunk;
pub mod error;
mod framing;
pub mod load;
mod notes;
pub mod reader;
mod records;
pub mod save;
pub mod session_reader;
pub mod session_recorder;
pub mod stream;
pub mod topics;
pub mod writer;

pub use error::McapFileError;
pub use load::{FileLosses, SalvagedCapture, read, salvage};
pub use notes::link_counters;
pub use reader::McapReader;
pub use save::write;
pub use session_reader::SessionReader;
pub use session_recorder::SessionRecorder;
pub use stream::CaptureStream;
pub use writer::Writer;
