//! The surface of `ihd`: its size, and the answers to spellings of former versions.

use std::process::Command;

use ihd::cli::moved::{MOVED, Moved};
use ihd::cli::pages;

/// Limit of the commands that do something themselves.
const MAX_COMMANDS: usize = 24;

/// Limit of the flags, --help and --version aside.
const MAX_FLAGS: usize = 100;

/// Counts the leaves below a command, and its flags and theirs.
fn count(command: &clap::Command) -> (usize, usize) {
    let own = command.get_arguments().filter(|a| is_flag(a)).count();
    if !command.has_subcommands() {
        return (1, own);
    }
    let below = command.get_subcommands().map(count);
    below.fold((0, own), |(a, b), (c, d)| (a + c, b + d))
}

fn is_flag(argument: &clap::Arg) -> bool {
    let is_own = !["help", "version"].contains(&argument.get_id().as_str());
    is_own && !argument.is_positional()
}

#[test]
fn the_surface_is_small() {
    let command = pages::command();
    let (commands, flags) = count(&command);
    println!("{commands} commands, {flags} flags");
    assert!(commands <= MAX_COMMANDS, "{commands} commands");
    assert!(flags <= MAX_FLAGS, "{flags} flags");
}

/// Old command line: the command with a device where it takes one.
fn old_line(moved: &Moved, command: &str) -> Vec<String> {
    let with_device = match command.strip_prefix("device") {
        Some(rest) => format!("device bench{rest}"),
        None => command.to_owned(),
    };
    let words = format!("{with_device} {}", moved.old);
    words.split_whitespace().map(str::to_owned).collect()
}

#[test]
fn an_old_spelling_is_answered_with_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    for moved in MOVED {
        for command in moved.commands {
            let line = old_line(moved, command);
            let mut ihd = Command::new(env!("CARGO_BIN_EXE_ihd"));
            let output = ihd.current_dir(&folder).args(&line).output();
            let output = output.expect("ihd runs");
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{line:?}: {stderr}");
            assert!(output.stdout.is_empty(), "{line:?}");
            let new = moved.spelled(command);
            assert!(stderr.contains(&new), "{line:?}: {new} not in {stderr}");
        }
    }
}

/// Words of the new spellings are commands, flags and keys that there are.
#[test]
fn a_new_spelling_exists() {
    for moved in MOVED {
        for command in moved.commands {
            let new = moved.spelled(command);
            if let Some(words) = new.strip_prefix("ihd ") {
                exists(&new, words);
                key_exists(command, &new);
            }
        }
    }
}

fn exists(new: &str, words: &str) {
    let root = pages::command();
    let mut at = &root;
    let words = words.split_whitespace();
    let mut is_value_next = false;
    for word in words {
        if word == "without" {
            return;
        }
        if std::mem::take(&mut is_value_next) {
            continue;
        }
        if let Some(flag) = word.strip_prefix("--") {
            let all = at.get_arguments().chain(root.get_arguments());
            let mut names = all.filter_map(clap::Arg::get_long);
            assert!(names.any(|name| name == flag), "{new}: no --{flag}");
            // Its value, if any, comes last.
            is_value_next = true;
        } else if let Some(below) = at.find_subcommand(word) {
            at = below;
        } else {
            let is_value = word.chars().next().is_some_and(char::is_uppercase)
                || ["previous", "builtin"].contains(&word)
                || word.contains('=');
            assert!(is_value, "{new}: {word} is no command of {}", at.get_name());
        }
    }
}

/// The key of `--sim KEY=VALUE` and the like is in the list of `--sim help`.
fn key_exists(command: &str, new: &str) {
    let words: Vec<&str> = new.split_whitespace().collect();
    let flags = ["--sim", "--input", "--set"];
    let found = words.iter().position(|word| flags.contains(word));
    let Some((flag, key)) = found.map(|at| (words[at], words[at + 1])) else {
        return;
    };
    let mut ihd = Command::new(env!("CARGO_BIN_EXE_ihd"));
    let output = ihd
        .args([command, flag, "help"])
        .output()
        .expect("ihd runs");
    assert_eq!(output.status.code(), Some(0), "{new}: {output:?}");
    let help = String::from_utf8_lossy(&output.stdout);
    assert!(help.starts_with("Keys"), "{new}: {help}");
    let key = key.split('=').next().unwrap_or_default();
    let is_there = |line: &str| line.trim().split('=').next() == Some(key);
    assert!(help.lines().any(is_there), "{new}: {help}");
}
