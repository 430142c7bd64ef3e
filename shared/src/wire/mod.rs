//! Wire: numbered postcard messages in CRC-checked COBS frames, the same bytes in process,
//! over TCP, over USB and in files.
//!
//! | module | holds |
//! |---|---|
//! | [`messages`] | every message: id, payload, the response to a request; one table |
//! | [`number`] | number of a request, by which its response is found |
//! | [`frame`], [`deframer`] | a message as a frame; frames from bytes, with counts of damage and loss |
//! | [`hello`] | version and capabilities of both ends, and if they fit |
//! | [`link_test`], [`timing`] | bytes of a test of the link; times that both ends keep |
//! | [`schema`] | names and units of every field, for documents and tools |
//!
//! Evolution: a new message or a new fault raises [`PROTOCOL_MINOR`], and so does a new [`messages::Outcome`] that
//! only a new message is answered with; any change of a message, an appended field included, raises
//! [`PROTOCOL_MAJOR`]. [`messages::Hello`] alone is frozen for ever,
//! so that any two builds can find out that they do not fit.

pub mod deframer;
mod enumerations;
pub mod frame;
pub mod hello;
pub mod link_test;
mod message_table;
pub mod messages;
pub mod number;
mod raw;
pub mod schema;
pub mod timing;

pub use messages::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// Rate of the link over a serial port, in bit/s.
pub const SERIAL_BAUD: u32 = 921_600;
