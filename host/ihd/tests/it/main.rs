//! The `ihd` command as a user calls it.

#[cfg(feature = "pinn")]
mod command_line;
mod completions_and_man;
mod convert;
#[cfg(all(feature = "daemon", unix))]
mod daemon;
mod doctor;
mod exit_codes;
mod flash;
mod identify;
mod inspect;
#[cfg(all(feature = "log", unix))]
mod log;
mod process;
mod record_replay;
mod simulate;
#[cfg(feature = "daemon")]
mod store;
#[cfg(feature = "pinn")]
mod trainer;
