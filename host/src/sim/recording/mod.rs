//! A simulated recording: what an oscilloscope or the board would have captured, and the truth.

pub mod settings;
pub mod sensing;
pub mod run;
