//! Completions and manual pages know every command.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use ihd::cli::pages;

/// Names of the pages of a command and all below it.
fn names(command: &clap::Command, path: &str, into: &mut BTreeSet<String>) {
    into.insert(format!("{path}.1"));
    for below in command.get_subcommands() {
        names(below, &format!("{path}-{}", below.get_name()), into);
    }
}

#[test]
fn every_command_has_a_manual_page_with_its_examples() {
    let folder = tempfile::tempdir().unwrap();
    pages::write(&folder.path().join("share")).unwrap();
    let out = folder.path().join("share/man/man1");
    let written: BTreeSet<String> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    let mut expected = BTreeSet::new();
    names(&pages::command(), "ihd", &mut expected);
    assert_eq!(written, expected);
    assert!(expected.len() > 15, "{expected:?}");
    let page = fs::read_to_string(out.join("ihd-doctor.1")).unwrap();
    for words in [".TH ihd-doctor 1", "Examples", "fix"] {
        assert!(page.contains(words), "{words}: {page}");
    }
}

/// If there is a bash, it reads the completions and completes by them.
#[cfg(unix)]
#[test]
fn bash_completes() {
    let folder = tempfile::tempdir().unwrap();
    pages::write(folder.path()).unwrap();
    let script = fs::read_to_string(folder.path().join("completions/ihd.bash")).unwrap();
    let asked = format!(
        "{script}\nCOMP_WORDS=(ihd doc); COMP_CWORD=1; _ihd ihd doc ihd; echo \"${{COMPREPLY[@]}}\""
    );
    let Ok(output) = Command::new("bash").args(["--norc", "-c", &asked]).output() else {
        return;
    };
    assert_eq!(
        String::from_utf8_lossy(&output.stdout).trim(),
        "doctor",
        "{output:?}"
    );
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let error = pages::write(&file).unwrap_err();
    assert!(format!("{error:#}").contains("file"));
}
