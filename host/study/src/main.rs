//! The `ihd-study` command.

use std::process::ExitCode;

use clap::Parser;
use ihd::cli::exit;
use ihd_study::cli::Cli;

fn main() -> ExitCode {
    match Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            exit::complain("ihd-study", &error);
            exit::exit_of(&error).into()
        }
    }
}
