//! Puts the firmware's image on a board, and reads its log.

pub mod dfu;
pub mod fake;
pub mod image;
pub mod install;
pub mod log;
pub mod log_source;
pub mod options;
#[cfg(feature = "probe")]
pub mod probe;
pub mod programmer;

pub use image::{BuildId, Image, ImageError};
pub use log_source::LogSource;
pub use options::OptionBytes;
pub use programmer::{Chip, Doing, Erase, ProgramError, Programmer, Progress};
