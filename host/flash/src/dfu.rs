//! The chip's bootloader in ROM, over USB: DfuSe 1.1a (ST AN3156) with the standard DFU 1.1.
//!
//! ```text
//! usb       finds and opens 0483:df11, through dfu-nusb
//! layout    memories that the device reports
//! protocol  blocks, commands and status, on dfu-core's DfuIo: a device, or a model of one
//! chip      Programmer: pages, blocks, verification, option bytes
//! restart   from the running firmware into the bootloader
//! ```
//!
//! dfu-core's own download does not suffice: it ends by starting the program before anything was read back.

mod chip;
pub mod layout;
mod protocol;
mod restart;
mod usb;

pub use chip::Dfu;
pub use protocol::{BootloaderIo, TransferFailure};
pub use restart::{EnterError, reach, send_into_bootloader};
pub use usb::{BootloaderDevice, PRODUCT_ID, Usb, VENDOR_ID, bootloaders, open};
