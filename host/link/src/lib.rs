//! The link to a controller: the same frames over a simulated hob, TCP, USB and serial.
//!
//! ```text
//!  Client ── requests ──► Transport ──► device
//!    ▲ answers, events      │ bytes ──► FrameSink (a recording)
//!    └── Incoming ◄─────────┘
//!        deframer, decoding, window assembler, counters
//! ```
//!
//! [`incoming::Incoming`] turns bytes into answers and events; a live client and a recording read
//! back (the crate `ihd-capture`) share it, so that both see the same windows and count the same damage.

pub mod assembler;
#[cfg(feature = "async")]
pub mod asynchronous;
pub mod client;
pub mod counters;
pub mod device_spec;
pub mod error;
#[cfg(test)]
mod fake;
pub mod incoming;
mod off;
pub mod older;
mod pieces;
mod printable;
pub mod protocol_doc;
pub mod replay;
mod resend;
pub mod serial;
pub mod service;
mod tap;
pub mod tcp;
pub mod transport;
pub mod usb;
pub mod window;

#[cfg(feature = "async")]
pub use asynchronous::AsyncClient;
pub use client::{Client, HEARD_EVERY};
pub use counters::Counters;
pub use device_spec::DeviceSpec;
pub use error::LinkError;
pub use incoming::Event;
pub use printable::printable_hello;
pub use service::{BoardFacts, LinkTest};
pub use transport::{FrameSink, Transport};
pub use window::{Window, WindowDefect};
