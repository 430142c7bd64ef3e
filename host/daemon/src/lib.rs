//! The daemon.

pub mod learning;
pub mod model;
