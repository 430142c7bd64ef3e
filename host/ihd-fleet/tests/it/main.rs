//! `ihd-fleet` as a user calls it, without a server.

#[path = "../../../ihd/tests/it/documents.rs"]
mod documents;

use std::path::Path;
use std::process::Command;

use clap::CommandFactory;
use ihd::cli::moved::MOVED;
use ihd_fleet_cli::cli::Cli;

fn run(args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd-fleet"));
    command.env_remove("IHD_FLEET_URL").args(args);
    let output = command.current_dir(std::env::temp_dir()).output();
    let output = output.expect("ihd-fleet runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let code = output.status.code().expect("an exit code");
    (code, text(&output.stdout), text(&output.stderr))
}

/// Spellings that have moved here lead to commands that there are.
#[test]
fn a_new_spelling_exists() {
    let mut seen = 0;
    for moved in MOVED {
        let Some(words) = moved.new.strip_prefix("ihd-fleet") else {
            continue;
        };
        seen += 1;
        let root = Cli::command();
        let mut at = &root;
        for word in words.split_whitespace() {
            if let Some(below) = at.find_subcommand(word) {
                at = below;
                continue;
            }
            let part = ["devices", "backlog", "dead"].contains(&word);
            let is_value = word.chars().all(|c| c.is_uppercase() || c == '|');
            assert!(
                (part && at.get_name() == "status") || is_value,
                "{}: {word}",
                moved.new
            );
        }
    }
    assert!(seen > 10, "{seen}");
}

#[test]
fn wrong_usage_is_2_and_named() {
    for (args, word) in [
        (&["status"][..], "which fleet?"),
        (&["status", "backlog", "--check"], "--check"),
        (&["status", "--delete"], "--delete"),
        (&["retry", "--json"], "--json"),
        (&["lookup", "push", "bench", "4711", "--json"], "--json"),
        (&["worker", "--name", "A B"], "--name"),
        (&["init", "--replicas", "2"], "--replicas"),
        (&["init", "up"], "--edge"),
        (&["init", "server-config"], "--site"),
    ] {
        let (code, stdout, stderr) = run(args);
        assert_eq!(code, 2, "{args:?}: {stderr}");
        assert!(stdout.is_empty(), "{args:?}: {stdout}");
        assert!(stderr.contains(word), "{args:?}: {stderr}");
    }
}

#[test]
fn the_documents_call_commands_that_there_are() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let calls = documents::calls(&root, "ihd-fleet");
    assert!(calls.len() >= 6, "{} commands only", calls.len());
    for (place, words) in calls {
        if let Err(error) = Cli::command().try_get_matches_from(&words) {
            panic!("{place}: {}\n{error}", words.join(" "));
        }
    }
}
