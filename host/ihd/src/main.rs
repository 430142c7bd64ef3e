//! The `ihd` command.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use ihd::cli::{self, Cli, output};

fn main() -> ExitCode {
    #[cfg(unix)]
    sigpipe::reset();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => return shown(&answer),
    };
    match cli.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::complain(format_args!("ihd: {}", cli::message(&error)));
            cli::exit_code(&error).into()
        }
    }
}

/// Shows help, version or what is wrong with the arguments.
fn shown(answer: &clap::Error) -> ExitCode {
    let printed = answer.print().and_then(|()| std::io::stdout().flush());
    match (printed, answer.exit_code()) {
        (Err(error), 0) => {
            output::complain(format_args!(
                "ihd: cannot write to standard output: {error}"
            ));
            ExitCode::FAILURE
        }
        (_, 0) => ExitCode::SUCCESS,
        _ => ExitCode::from(2),
    }
}
