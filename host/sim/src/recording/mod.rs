//! A simulated recording: what an oscilloscope or the board would have captured, and the truth.

pub mod comparison;
pub mod file;
pub mod prepared;
pub mod run;
pub mod sampler;
pub mod sensing;
pub mod settings;
