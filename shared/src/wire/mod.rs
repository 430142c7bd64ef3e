//! The wire: numbered postcard messages in CRC-checked COBS frames, the same bytes in process,
//! over TCP, over USB and in files.
//!
//! Evolution: a new message or a new fault raises [`PROTOCOL_MINOR`], and so does a new [`messages::Outcome`] that
//! only a new message is answered with; any change of a message, an appended field included, raises
//! [`PROTOCOL_MAJOR`]. [`messages::Hello`] alone is frozen for ever,
//! so that any two builds can find out that they do not fit.

pub mod deframer;
pub mod frame;
pub mod hello;
pub mod link_test;
pub mod messages;
pub mod number;
pub mod schema;
pub mod timing;

/// Raised by any change of an existing message.
pub const PROTOCOL_MAJOR: u16 = 3;

/// Raised by a new message or a new fault.
pub const PROTOCOL_MINOR: u16 = 0;
