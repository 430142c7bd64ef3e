//! Contents of a release's archive, as packaging/archive makes it of a stand-in for the program.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// Stands in for `ihd`: a page for `man`, a line for `completions`.
const PROGRAM: &str = "#!/bin/sh\n\
    case $1 in\n\
    man) mkdir -p \"$3\" && echo page > \"$3/ihd.1\" ;;\n\
    completions) echo \"for $2\" ;;\n\
    *) exit 2 ;;\n\
    esac\n";

/// Packs `folder/ihd` into `folder/out`.
fn pack(folder: &Path) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/archive");
    let mut command = Command::new(script);
    command.arg(folder.join("ihd")).arg("ihd-v1-here");
    command.arg(folder.join("out")).output().unwrap()
}

fn make_program(folder: &Path, script: &str) {
    let path = folder.join("ihd");
    fs::write(&path, script).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn an_archive_holds_program_pages_completions_rule_and_licences() {
    let folder = tempfile::tempdir().unwrap();
    make_program(folder.path(), PROGRAM);
    // Twice: what is there is replaced.
    for _ in 0..2 {
        let packed = pack(folder.path());
        assert!(packed.status.success(), "{packed:?}");
    }
    let out = folder.path().join("out");
    let mut tar = Command::new("tar");
    let listed = tar.arg("-tzf").arg(out.join("ihd-v1-here.tar.gz"));
    let listed = String::from_utf8(listed.output().unwrap().stdout).unwrap();
    let files = listed.lines().filter(|line| !line.ends_with('/'));
    let files: BTreeSet<&str> = files
        .map(|file| file.strip_prefix("ihd-v1-here/").unwrap())
        .collect();
    let expected = BTreeSet::from([
        "70-ihd.rules",
        "CHANGELOG.md",
        "LICENSE-APACHE",
        "LICENSE-MIT",
        "README.md",
        "completions/_ihd",
        "completions/ihd.bash",
        "completions/ihd.elv",
        "completions/ihd.fish",
        "completions/ihd.ps1",
        "docs/bring-up.md",
        "docs/first-power-up.md",
        "ihd",
        "man/man1/ihd.1",
        "systemd/ihd.service",
    ]);
    assert_eq!(files, expected);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1, "the folder is gone");
}

#[test]
fn a_program_that_fails_or_is_not_there_makes_no_archive() {
    let folder = tempfile::tempdir().unwrap();
    let missing = pack(folder.path());
    assert!(!missing.status.success());
    assert!(String::from_utf8_lossy(&missing.stderr).contains("PROGRAM that was built"));
    let silent = PROGRAM.replace("echo \"for $2\"", "true");
    for program in ["#!/bin/sh\necho no such command >&2; exit 2\n", &silent] {
        make_program(folder.path(), program);
        assert!(!pack(folder.path()).status.success());
        let out = fs::read_dir(folder.path().join("out")).unwrap();
        assert_eq!(out.count(), 0);
    }
}
