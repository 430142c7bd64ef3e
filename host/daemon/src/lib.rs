//! The daemon.

pub mod model;
