//! USB: the chip's peripheral, and the host at the other end of the cable.
//!
//! ```text
//!  firmware ── registers, packet memory ──► peripheral::Usb ◄── packets ── host::HostController ◄── cable::Cable
//!                                        (or any bus::Device)           polled by the machine's   held by other threads:
//!                                                                       thread, emulated time     client, usbip
//! ```

pub mod bus;
pub mod cable;
pub mod client;
mod endpoint;
pub mod host;
mod packet_memory;
pub mod peripheral;
pub mod rom_device;
pub mod stand_in;
pub mod transfer;
pub mod usbip;

pub use bus::{Answer, Device, Handshake, Toggle};
pub use cable::Cable;
pub use client::Board;
pub use host::HostController;
pub use peripheral::Usb;
pub use rom_device::RomDevice;
pub use stand_in::StandIn;
pub use transfer::{Outcome, Request, Status};
