//! USB: the chip's peripheral, and what is at the other end of the cable.
//!
//! ```text
//!  firmware ── registers, packet memory ──► peripheral::Usb ◄── packets ── host::HostController ◄── host::Cable
//!                                        (or any bus::Device)           polled by the machine's   held by other threads:
//!                                                                       thread, emulated time     client, usbip
//! ```

pub mod bus;
mod endpoint;
//HOST pub mod host;
mod packet_memory;
pub mod peripheral;
//HOST pub mod transfer;

pub use bus::{Answer, Device, Handshake, Toggle};
//HOST pub use host::{Cable, HostController};
pub use peripheral::Usb;
//HOST pub use transfer::{Outcome, Request, Status};
