//! The `ihd` command.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use ihd::cli::{self, Cli, output};

fn main() -> ExitCode {
    #[cfg(unix)]
    sigpipe::reset();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            let code = shown(&answer);
            if answer.kind() == ErrorKind::InvalidSubcommand {
                hint_at_moved();
            }
            return code;
        }
    };
    match cli.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::complain(format_args!("ihd: {}", cli::message(&error)));
            cli::exit_code(&error).into()
        }
    }
}

/// Prints help, version or an error of the arguments.
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

/// Commands of former versions, and where they are now.
const MOVED: [(&str, &str); 1] = [("study", "ihd-study (cargo run -p ihd-study)")];

/// Names the new place of a command that has moved.
fn hint_at_moved() {
    let asked = std::env::args().nth(1);
    for (old, new) in MOVED {
        if asked.as_deref() == Some(old) {
            output::complain(format_args!("ihd: `ihd {old}` is {new} now"));
        }
    }
}
