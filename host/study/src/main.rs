//! The `ihd-study` command.

use std::process::ExitCode;

use clap::Parser;
use ihd::cli::output;
use ihd_study::cli::Cli;

fn main() -> ExitCode {
    match Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::complain(format_args!("ihd-study: {}", ihd::cli::message(&error)));
            ihd::cli::exit::exit_of(&error).into()
        }
    }
}
