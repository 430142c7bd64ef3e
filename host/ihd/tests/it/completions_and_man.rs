//! Completions and manual pages know every command.

use std::collections::BTreeSet;
use std::fs;
use std::process::{Command, Output};

fn ihd(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command.args(args).output().expect("ihd runs")
}

fn stdout(args: &[&str]) -> String {
    let output = ihd(args);
    assert!(output.status.success(), "{args:?}: {output:?}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// The subcommands that `--help` of a command lists.
fn subcommands(of: &[String]) -> Vec<String> {
    let mut args: Vec<&str> = of.iter().map(String::as_str).collect();
    args.push("--help");
    let help = stdout(&args);
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let lines = lines.take_while(|line| !line.is_empty());
    // Deeper lines go on with a description.
    let lines = lines.filter(|line| !line.starts_with("   "));
    let names = lines.filter_map(|line| line.split_whitespace().next());
    names.filter(|n| *n != "help").map(str::to_owned).collect()
}

/// Every command, each as its words.
fn commands() -> Vec<Vec<String>> {
    let mut found: Vec<Vec<String>> = vec![Vec::new()];
    let mut next = 0;
    while next < found.len() {
        let parent = found[next].clone();
        next += 1;
        for name in subcommands(&parent) {
            found.push([parent.clone(), vec![name]].concat());
        }
    }
    assert!(found.len() > 15, "{found:?}");
    found
}

#[test]
fn every_command_has_a_manual_page_with_its_examples() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("share/man1");
    stdout(&["man", "--out", out.to_str().unwrap()]);
    let written: BTreeSet<String> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    let expected: BTreeSet<String> = commands()
        .into_iter()
        .map(|words| [vec!["ihd".to_owned()], words].concat().join("-") + ".1")
        .collect();
    assert_eq!(written, expected);
    let page = fs::read_to_string(out.join("ihd-doctor.1")).unwrap();
    for words in [".TH ihd-doctor 1", "Examples", "fix"] {
        assert!(page.contains(words), "{words}: {page}");
    }
}

#[test]
fn every_shell_completes_every_first_word() {
    let names = subcommands(&[]);
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = stdout(&["completions", shell]);
        for name in &names {
            assert!(script.contains(name.as_str()), "{shell}: no {name}");
        }
        assert!(script.contains("first-switching"), "{shell}");
    }
    assert_eq!(ihd(&["completions", "cmd.exe"]).status.code(), Some(2));
}

/// Where there is a bash, it takes what is written for it, and completes by it.
#[cfg(unix)]
#[test]
fn bash_completes() {
    let script = stdout(&["completions", "bash"]);
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
    let output = ihd(&["man", "--out", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("file"));
}
