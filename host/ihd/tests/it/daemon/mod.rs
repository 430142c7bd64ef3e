//! The daemon and `ihd device` as a user has them: processes, signals, exit codes.

mod commands;
mod directly;
mod document;
mod ends;
mod processes;
mod refusals;
mod ui;
mod watch;
