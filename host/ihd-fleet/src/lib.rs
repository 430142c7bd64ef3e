//! `ihd-fleet`: sets up and serves a fleet of hobs and workers on a NATS server.
//!
//! It stands above `ihd`'s library, of which it takes configuration, output and exit codes; host/fleet does the work. The daemon's own
//! part, the edge, is in `ihd`.

pub mod cli;
