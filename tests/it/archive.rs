//! Contents of a release's archive, as packaging/archive makes it of stand-ins for the programs.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// Stands in for the program that writes the pages: a page, and a line for each shell.
const PAGES: &str = "#!/bin/sh\n\
    mkdir -p \"$1/man/man1\" \"$1/completions\" && echo page > \"$1/man/man1/ihd.1\"\n\
    for file in ihd.bash _ihd ihd.fish ihd.ps1 ihd.elv; do echo line > \"$1/completions/$file\"; done\n";

/// Packs `folder/ihd` with the pages of `folder/pages` into `folder/out`.
fn pack(folder: &Path) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/archive");
    let mut command = Command::new(script);
    command.args([folder.join("ihd"), folder.join("pages")]);
    command
        .arg("ihd-v1-here")
        .arg(folder.join("out"))
        .output()
        .unwrap()
}

fn make_program(folder: &Path, name: &str, script: &str) {
    let path = folder.join(name);
    fs::write(&path, script).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn an_archive_holds_program_pages_completions_rule_and_licences() {
    let folder = tempfile::tempdir().unwrap();
    make_program(folder.path(), "ihd", "#!/bin/sh\n");
    make_program(folder.path(), "ihd-fleet", "#!/bin/sh\n");
    make_program(folder.path(), "pages", PAGES);
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
        "docs/board.md",
        "docs/bring-up.md",
        "docs/daemon.md",
        "ihd",
        "ihd-fleet",
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
    make_program(folder.path(), "ihd", "#!/bin/sh\n");
    let silent = PAGES.replace("echo line", "true");
    for program in ["#!/bin/sh\necho no such command >&2; exit 2\n", &silent] {
        make_program(folder.path(), "pages", program);
        assert!(!pack(folder.path()).status.success());
        let out = fs::read_dir(folder.path().join("out")).unwrap();
        assert_eq!(out.count(), 0);
    }
}
