//! Made-up inputs, and addresses, for tests of several crates.

mod free_address;
pub mod image;
pub mod log;
pub mod log_board;
mod telemetry;

pub use free_address::free_address;
pub use image::SampleImage;
pub use log::SampleLog;
pub use log_board::LogBoard;
pub use telemetry::telemetry;
