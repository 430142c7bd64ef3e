//! The `ihd` command.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use ihd::cli::{self, Cli, moved, output};

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            if answer.exit_code() != 0
                && let Some(moved) = moved::answer(&arguments())
            {
                output::complain(format_args!("ihd: {moved}"));
                return ExitCode::from(2);
            }
            return shown(&answer);
        }
    };
    match cli.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            cli::exit::complain("ihd", &error);
            cli::exit::exit_of(&error).into()
        }
    }
}

/// Prints help, version or an error of the arguments.
fn shown(answer: &clap::Error) -> ExitCode {
    let text = answer.render().to_string();
    let printed = match text.strip_prefix("error: ") {
        // A list of keys is no error, though clap writes so.
        Some(keys) if answer.exit_code() == 0 => std::io::stdout().write_all(keys.as_bytes()),
        _ => answer.print(),
    };
    let is_version = answer.kind() == ErrorKind::DisplayVersion;
    let is_long = || arguments().iter().any(|argument| argument == "--version");
    let details = (is_version && is_long()).then(cli::version_details);
    let details = details.unwrap_or_default();
    let printed = printed.and_then(|()| std::io::stdout().write_all(details.as_bytes()));
    let printed = printed.and_then(|()| std::io::stdout().flush());
    match (printed, answer.exit_code()) {
        (Err(error), 0) => {
            cli::exit::complain("ihd", &output::output_error(error));
            ExitCode::FAILURE
        }
        (_, 0) => ExitCode::SUCCESS,
        _ => ExitCode::from(2),
    }
}

/// Arguments as text.
fn arguments() -> Vec<String> {
    let arguments = std::env::args_os().skip(1);
    arguments
        .map(|a| a.to_string_lossy().into_owned())
        .collect()
}
