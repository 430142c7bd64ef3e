//! The `ihd-fleet` command.

use std::process::ExitCode;

use clap::Parser;
use ihd::cli::output;
use ihd_fleet_cli::cli::{self, Cli};

fn main() -> ExitCode {
    match Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::complain(format_args!("ihd-fleet: {}", ihd::cli::message(&error)));
            cli::exit_of(&error).into()
        }
    }
}
