//! Made-up inputs for tests of several crates.

pub mod image;
pub mod log;
mod telemetry;

pub use image::SampleImage;
pub use log::SampleLog;
pub use telemetry::telemetry;
