//! Options of every command.

use std::path::PathBuf;

use clap::Args;

/// Options of every command.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Every command")]
pub struct Global {
    /// Print JSON instead of text
    #[arg(long, global = true)]
    pub json: bool,
    /// Configuration of the daemon, which also names devices; without one ihd.toml of this folder, or what is built in
    /// (docs/daemon.md)
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
}
