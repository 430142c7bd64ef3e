//! The `ihd` command as a user calls it.

#[cfg(feature = "pinn")]
mod command_line;
mod convert;
#[cfg(all(feature = "daemon", unix))]
mod daemon;
mod doctor;
#[cfg(all(feature = "daemon", feature = "log", target_os = "linux"))]
mod documented;
#[cfg(all(feature = "daemon", feature = "log"))]
mod documents;
mod exit_codes;
mod flash;
mod identify;
mod identify_page;
mod inspect;
#[cfg(all(feature = "log", unix))]
mod log;
mod pages;
mod process;
mod record_replay;
mod simulate;
#[cfg(feature = "daemon")]
mod store;
#[cfg(all(feature = "daemon", feature = "log"))]
mod surface;
#[cfg(feature = "pinn")]
mod trainer;
