//! The house's own rules for files: what a name may be, and what may not stand in the code.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, bail};

use crate::source::{code_only, is_word};

/// Names that say nothing about what is inside.
const EMPTY_NAMES: [&str; 6] = ["utils", "util", "helpers", "helper", "common", "misc"];
/// The only place that talks to registers.
const BOARD: &str = "firmware/src/board";

/// Every breach of the rules in the tracked files, as `file:line: what`.
pub fn check(root: &Path) -> anyhow::Result<Vec<String>> {
    let mut broken = Vec::new();
    for path in tracked(root)? {
        broken.extend(name_breach(&path));
        if path.ends_with(".rs") {
            let text = match fs::read_to_string(root.join(&path)) {
                Ok(text) => text,
                // Deleted, and not yet committed.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                Err(error) => return Err(error).with_context(|| format!("could not read {path}")),
            };
            broken.extend(code_breaches(&path, &text));
        }
    }
    Ok(broken)
}

fn tracked(root: &Path) -> anyhow::Result<Vec<String>> {
    let mut git = Command::new("git");
    // A checkout that belongs to another user, as in a container, is still only listed.
    git.arg("-c")
        .arg(format!("safe.directory={}", root.display()));
    let output = git
        .args(["ls-files", "-z"])
        .current_dir(root)
        .output()
        .context("could not start git; install it")?;
    if !output.status.success() {
        bail!(
            "`git ls-files` failed in {}: {}",
            root.display(),
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let list = String::from_utf8(output.stdout).context("a tracked file's name is not UTF-8")?;
    let names = list.split('\0').filter(|name| !name.is_empty());
    Ok(names.map(str::to_owned).collect())
}

/// A folder counts as much as a file.
fn name_breach(path: &str) -> Option<String> {
    let stems = path
        .split('/')
        .map(|part| part.split('.').next().unwrap_or(part));
    let empty = stems.into_iter().find(|stem| EMPTY_NAMES.contains(stem))?;
    Some(format!(
        "{path}: \"{empty}\" says nothing; name it for what it is"
    ))
}

fn code_breaches(path: &str, text: &str) -> Vec<String> {
    let board = path.strip_prefix(BOARD);
    let on_board = board.is_some_and(|rest| rest.starts_with(['/', '.']));
    let code = code_only(text);
    let mut broken = Vec::new();
    for (index, line) in code.lines().enumerate() {
        let mut report = |what: &str| broken.push(format!("{path}:{}: {what}", index + 1));
        if !on_board && holds_word(line, "unsafe", "") {
            report("unsafe code outside firmware/src/board");
        }
        for stub in ["todo", "unimplemented"] {
            if holds_word(line, stub, "!") {
                report("unfinished code; finish it or return an error that says so");
            }
        }
        if line.contains("#[ignore") {
            report("an ignored test; make it pass or remove it");
        }
    }
    broken
}

/// Whether `word` stands in `line` as a whole word with `mark` right behind it.
fn holds_word(line: &str, word: &str, mark: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let after = &line[at + word.len()..];
        !line[..at].ends_with(is_word) && !after.starts_with(is_word) && after.starts_with(mark)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsafe_belongs_to_the_board_alone() {
        let text = "fn read() {\n    unsafe { go() }\n}";
        let broken = code_breaches("host/src/link.rs", text);
        assert_eq!(broken.len(), 1);
        assert!(broken[0].starts_with("host/src/link.rs:2: "), "{broken:?}");
        assert!(code_breaches("firmware/src/board/adc.rs", text).is_empty());
        assert!(code_breaches("firmware/src/board.rs", text).is_empty());
        assert!(!code_breaches("firmware/src/boards.rs", text).is_empty());
    }

    #[test]
    fn words_in_comments_strings_and_other_names_are_no_breach() {
        let text = "#![forbid(unsafe_code)] // unsafe\nlet a = \"todo!()\"; let todo = 1;";
        assert!(code_breaches("a.rs", text).is_empty());
    }

    #[test]
    fn unfinished_code_and_ignored_tests_are_found() {
        let text = "todo!()\nunimplemented!(\"x\")\n#[ignore = \"slow\"]\n#[ignore]";
        assert_eq!(code_breaches("a.rs", text).len(), 4);
    }

    #[test]
    fn names_say_what_is_inside() {
        assert!(name_breach("host/src/utils.rs").is_some());
        assert!(name_breach("tests/common/mod.rs").is_some());
        assert!(name_breach("host/src/lookup.rs").is_none());
        assert!(name_breach("host/src/common_mode.rs").is_none());
    }

    #[test]
    fn this_workspace_lists_its_files() {
        let workspace = crate::workspace::Workspace::find().unwrap();
        let files = tracked(workspace.root()).unwrap();
        assert!(files.iter().any(|file| file == "Cargo.toml"));
    }
}
