//! Simulated recording: data as an oscilloscope or the board would capture them, and the truth.

pub mod comparison;
pub mod file;
pub mod prepared;
pub mod run;
pub mod sampler;
pub mod sensing;
pub mod settings;
