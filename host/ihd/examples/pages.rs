//! Writes the manual pages and completions of `ihd` to a folder: `cargo run --example pages -- DIR`.

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(folder), None) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: pages DIR");
        return ExitCode::from(2);
    };
    match ihd::cli::pages::write(Path::new(&folder)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("pages: {}", ihd::cli::message(&error));
            ExitCode::FAILURE
        }
    }
}
