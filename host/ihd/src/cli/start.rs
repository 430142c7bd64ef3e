//! `ihd` alone: daemon, boards, store and captures found here, and the next command for each.

use std::path::{Path, PathBuf};

use anyhow::Result;
use ihd_link::usb;
use serde::Serialize;

use super::global::Global;
use super::output;

/// Endings of capture files (host/capture has the formats).
const CAPTURE_ENDINGS: [&str; 7] = ["csv", "isf", "mat", "mcap", "npz", "trc", "wfm"];

/// Command to try next, and its cause.
#[derive(Debug, PartialEq, Serialize)]
struct NextStep {
    /// Thing found here.
    here: String,
    /// Command line.
    command: String,
    /// Effect of the command.
    effect: &'static str,
}

impl NextStep {
    fn new(here: impl Into<String>, command: impl Into<String>, effect: &'static str) -> Self {
        Self {
            here: here.into(),
            command: command.into(),
            effect,
        }
    }
}

/// Prints the next steps.
///
/// # Errors
/// If standard output cannot be written. A thing that cannot be looked at is a line on standard error.
pub fn print(global: &Global) -> Result<()> {
    let mut steps = boards();
    #[cfg(feature = "daemon")]
    steps.extend(of_daemon(global));
    steps.extend(captures(Path::new(".")));
    if steps.is_empty() {
        steps = without_anything();
    }
    if global.json {
        return output::json(&steps);
    }
    say!("{}", text(&steps))
}

/// Steps as text, in columns.
fn text(steps: &[NextStep]) -> String {
    let width = |of: fn(&NextStep) -> &str| {
        let lengths = steps.iter().map(|step| of(step).chars().count());
        lengths.max().unwrap_or(0)
    };
    let here = width(|step| &step.here);
    let command = width(|step| &step.command);
    let mut lines = vec![
        format!(
            "ihd {}: identifies an induction hob's load and teaches its controller.\n",
            env!("CARGO_PKG_VERSION")
        ),
        "Found here, and the next command:".to_owned(),
    ];
    lines.extend(steps.iter().map(|step| {
        let NextStep {
            here: found,
            command: line,
            effect,
        } = step;
        format!("  {found:<here$}   {line:<command$}   {effect}")
    }));
    lines.push("\nAll commands: ihd --help".to_owned());
    lines.join("\n")
}

/// Steps of a folder with nothing in it, on a machine with nothing plugged in.
fn without_anything() -> Vec<NextStep> {
    let simulated = "no board, no daemon, no capture";
    vec![
        NextStep::new(
            simulated,
            "ihd trainer",
            "identifies a simulated hob and teaches it",
        ),
        NextStep::new(
            "",
            "ihd identify CAPTURE",
            "R(t) and L(t) of a scope's file",
        ),
        NextStep::new("", "ihd doctor", "checks this machine, and a board"),
    ]
}

/// Boards on USB.
fn boards() -> Vec<NextStep> {
    // A machine without USB has no boards on it; `ihd doctor` tells why.
    let boards = usb::boards().unwrap_or_default();
    boards.iter().map(of_board).collect()
}

fn of_board(board: &usb::UsbBoard) -> NextStep {
    let usb::UsbBoard { serial, product } = board;
    let command = format!("ihd doctor usb:{serial}");
    NextStep::new(format!("{product} {serial} on USB"), command, "checks it")
}

/// The daemon that the configuration describes, and its store.
#[cfg(feature = "daemon")]
fn of_daemon(global: &Global) -> Vec<NextStep> {
    use super::configured;

    let complaint = |error: &anyhow::Error| {
        output::complain(format_args!("ihd: {}", super::message(error)));
    };
    let config = match configured::config(global.config.as_deref()) {
        Ok(config) => config,
        Err(error) => {
            complaint(&error);
            return Vec::new();
        }
    };
    let mut steps = Vec::new();
    match configured::daemon(&config) {
        Ok(Some(client)) => steps.push(NextStep::new(
            format!("daemon at {}", client.url()),
            "ihd device status",
            "its devices; ihd watch shows them live",
        )),
        Ok(None) => {}
        Err(error) => complaint(&error),
    }
    if config.store.join(ihd_store::folder::RECORDS).exists() {
        steps.push(NextStep::new(
            format!("store {}", config.store.display()),
            "ihd store ls",
            "its results",
        ));
    }
    steps
}

/// The newest capture of a folder.
fn captures(folder: &Path) -> Option<NextStep> {
    let files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let ending = path.extension().and_then(|e| e.to_str());
            ending.is_some_and(|e| CAPTURE_ENDINGS.contains(&e.to_lowercase().as_str()))
        })
        .collect();
    let newest = files
        .iter()
        .max_by_key(|path| path.metadata().and_then(|m| m.modified()).ok())?;
    let name = newest.strip_prefix(".").unwrap_or(newest).display();
    let here = match files.len() {
        1 => format!("capture {name}"),
        n => format!("{n} captures, newest {name}"),
    };
    let argument = match newest.to_string_lossy().contains(char::is_whitespace) {
        true => format!("\"{name}\""),
        false => name.to_string(),
    };
    let effect = "channels, rate, frequency, defects; then ihd identify";
    Some(NextStep::new(
        here,
        format!("ihd inspect {argument}"),
        effect,
    ))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn every_command_is_one() {
        let board = usb::UsbBoard {
            serial: "2062".into(),
            product: "ihd hob".into(),
        };
        let mut steps = without_anything();
        steps.push(of_board(&board));
        for step in steps {
            let parsed = Cli::try_parse_from(step.command.split(' '));
            assert!(parsed.is_ok(), "{}: {:?}", step.command, parsed.err());
        }
    }

    #[test]
    fn the_newest_capture_is_offered_and_other_files_are_not() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(captures(folder.path()), None);
        let write = |name: &str, age_s: u64| {
            let path = folder.path().join(name);
            std::fs::write(&path, "t,v,i\n").unwrap();
            let time = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000 - age_s);
            let file = std::fs::File::options().write(true).open(path).unwrap();
            file.set_modified(time).unwrap();
        };
        write("notes.txt", 0);
        assert_eq!(captures(folder.path()), None);
        write("old.csv", 100);
        write("scope.WFM", 10);
        let step = captures(folder.path()).unwrap();
        assert!(step.here.starts_with("2 captures"), "{step:?}");
        assert!(step.command.contains("scope.WFM"), "{step:?}");
    }
}
