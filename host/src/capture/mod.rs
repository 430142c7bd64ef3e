//! Recordings of what a device sent.

pub mod frames;
