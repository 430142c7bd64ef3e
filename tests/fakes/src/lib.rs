//! Made-up inputs for tests of several crates.

pub mod image;
pub mod log;
pub mod log_board;
mod telemetry;

pub use image::SampleImage;
pub use log::SampleLog;
pub use log_board::LogBoard;
pub use telemetry::telemetry;
