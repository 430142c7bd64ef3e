//! Made-up inputs for tests of several crates.

pub mod image;
pub mod log;

pub use image::SampleImage;
pub use log::SampleLog;
