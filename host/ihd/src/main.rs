//! The `ihd` command.

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    #[cfg(unix)]
    sigpipe::reset();
    match ihd::cli::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("ihd: {}", ihd::cli::message(&error));
            ihd::cli::exit_code(&error).into()
        }
    }
}
