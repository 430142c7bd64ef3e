//! The link to a controller: the same frames over a simulated hob, TCP, USB and serial.
//!
//! ```text
//!  Client ── requests ──► Transport ──► device
//!    ▲ answers, events      │ bytes ──► FrameSink (a recording)
//!    └── Receiver ◄─────────┘
//!        deframer, decoding, window assembler, counters
//! ```
//!
//! [`receiver::Receiver`] turns bytes into responses and events. A live client and a recording that is read back (crate
//! `ihd-capture`) share it, so both yield the same windows and count the same damage.

pub mod assembler;
#[cfg(feature = "async")]
pub mod asynchronous;
pub mod client;
pub mod counters;
pub mod device_spec;
pub mod error;
#[cfg(test)]
mod fake;
mod flood;
mod frame_aligner;
mod frame_tee;
mod granted_power;
mod off;
mod partial_payload;
mod printable;
pub mod protocol_doc;
pub mod receiver;
pub mod replay;
mod resend;
pub mod serial;
pub mod service;
pub mod tcp;
pub mod transport;
pub mod usb;
pub mod window;

#[cfg(feature = "async")]
pub use asynchronous::AsyncClient;
pub use client::{Client, KEEPALIVE_PERIOD};
pub use counters::ClientCounters;
pub use device_spec::DeviceSpec;
pub use error::LinkError;
pub use frame_aligner::FrameAligner;
pub use granted_power::GrantedPower;
pub use printable::printable_hello;
pub use receiver::DeviceEvent;
pub use service::{BoardFacts, LinkTest};
pub use transport::{FrameSink, Transport};
pub use window::{Window, WindowDefect};
