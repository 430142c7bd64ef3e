//! The `ihd-fleet` command.

use std::process::ExitCode;

use clap::Parser;
use ihd_fleet_cli::cli::{self, Cli};

fn main() -> ExitCode {
    match Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            ihd::cli::exit::complain("ihd-fleet", &error);
            cli::exit_of(&error).into()
        }
    }
}
