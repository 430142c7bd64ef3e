//! The daemon and `ihd device` as a user has them: processes, signals, exit codes.

mod commands;
mod directly;
mod document;
mod ends;
pub mod processes;
mod refusals;
pub mod screen;
mod ui;
mod watch;
