//! The daemon and the commands on bad links, with hostile devices, killed at random, and for long. What takes longer than twenty
//! seconds is ignored here, has a short case beside it, and is run by `cargo xtask test --full`; docs/daemon.md has the results of the
//! long forms.
#![cfg(all(feature = "daemon", target_os = "linux"))]

mod chance;
mod daemon;
mod device;
mod full_disk;
mod hob_port;
mod hostile;
mod hostile_to_commands;
mod hostile_to_daemon;
mod http;
mod kills;
mod many;
mod off_latency;
mod player;
mod process;
mod proxy;
mod soak;
