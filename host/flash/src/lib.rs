//! Installation of the firmware's image on a board, and reading of its log.
//!
//! ```text
//!  Image (ELF, checked) ─► install ─► Programmer ─┬─ probe: debug probe (probe-rs)
//!                                                 └─ dfu: the chip's USB bootloader
//!  probe (RTT) or link ─► log ─► messages
//! ```

pub mod dfu;
#[cfg(test)]
mod fake;
pub mod image;
pub mod install;
pub mod log;
pub mod options;
#[cfg(feature = "probe")]
pub mod probe;
pub mod programmer;

pub use image::{BuildId, Image, ImageError};
pub use options::OptionBytes;
pub use programmer::{Chip, Erase, FlashStep, ProgramError, Programmer, WriteProgress};
