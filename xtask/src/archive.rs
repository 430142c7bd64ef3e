//! A release's archive: the program, its manual pages and completions, the udev rule, services, licences.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

use crate::workspace::{Workspace, run};

/// Shells, and what their completion files are called.
const COMPLETIONS: [(&str, &str); 5] = [
    ("bash", "ihd.bash"),
    ("zsh", "_ihd"),
    ("fish", "ihd.fish"),
    ("powershell", "ihd.ps1"),
    ("elvish", "ihd.elv"),
];

/// What is copied as it is: from the checkout, to the archive.
const COPIED: [(&str, &str); 8] = [
    ("README.md", "README.md"),
    ("CHANGELOG.md", "CHANGELOG.md"),
    ("LICENSE-MIT", "LICENSE-MIT"),
    ("LICENSE-APACHE", "LICENSE-APACHE"),
    ("docs/70-ihd.rules", "70-ihd.rules"),
    ("docs/bring-up.md", "docs/bring-up.md"),
    ("docs/first-power-up.md", "docs/first-power-up.md"),
    ("packaging/systemd/ihd.service", "systemd/ihd.service"),
];

/// Makes `out/NAME.tar.gz` (on Windows `NAME.zip`) of a program that runs on this machine.
pub fn pack(workspace: &Workspace, program: &Path, name: &str, out: &Path) -> anyhow::Result<()> {
    let program = fs::canonicalize(program)
        .with_context(|| format!("no program at {}: build it first", program.display()))?;
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let out = fs::canonicalize(out)?;
    let folder = fill(&workspace.root, &program, &out.join(name))?;
    let archive = match cfg!(windows) {
        true => format!("{name}.zip"),
        false => format!("{name}.tar.gz"),
    };
    // Windows' own, which is bsdtar and makes what the name's end says; another may come first in its path.
    let (tar, options) = match cfg!(windows) {
        true => (r"C:\Windows\System32\tar.exe", "-acf"),
        false => ("tar", "-czf"),
    };
    let mut tar = Command::new(tar);
    run(tar.current_dir(&out).args([options, &archive, name]))?;
    fs::remove_dir_all(&folder)?;
    println!("{}", out.join(archive).display());
    Ok(())
}

/// Fills the folder that is packed, anew.
fn fill(root: &Path, program: &Path, folder: &Path) -> anyhow::Result<PathBuf> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    let name = program.file_name().context("a program has a name")?;
    let mut copies: Vec<(PathBuf, PathBuf)> = vec![(program.to_owned(), folder.join(name))];
    let to_folder = |(from, to): (&str, &str)| (root.join(from), folder.join(to));
    copies.extend(COPIED.map(to_folder));
    for (from, to) in copies {
        if let Some(parent) = to.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::copy(&from, &to).with_context(|| format!("cannot copy {}", from.display()))?;
    }
    let pages = folder.join("man/man1");
    printed(program, &["man", "--out", &pages.display().to_string()])?;
    let completions = folder.join("completions");
    fs::create_dir_all(&completions)?;
    for (shell, file) in COMPLETIONS {
        let script = printed(program, &["completions", shell])?;
        ensure!(!script.is_empty(), "no completions for {shell}");
        fs::write(completions.join(file), script)?;
    }
    Ok(folder.to_owned())
}

/// What a program prints.
fn printed(program: &Path, args: &[&str]) -> anyhow::Result<Vec<u8>> {
    let output = Command::new(program).args(args).output();
    let output = output.with_context(|| {
        format!(
            "{} does not run here: pack it where it does",
            program.display()
        )
    })?;
    ensure!(
        output.status.success(),
        "{} {} failed: {}",
        program.display(),
        args.join(" "),
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(output.stdout)
}

#[cfg(all(test, unix))]
mod tests {
    use std::collections::BTreeSet;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// Stands in for `ihd`: a page for `man`, a line for `completions`.
    const PROGRAM: &str = "#!/bin/sh\n\
        case $1 in\n\
        man) mkdir -p \"$3\" && echo page > \"$3/ihd.1\" ;;\n\
        completions) echo \"for $2\" ;;\n\
        *) exit 2 ;;\n\
        esac\n";

    fn program(folder: &Path, script: &str) -> PathBuf {
        let path = folder.join("ihd");
        fs::write(&path, script).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn scratch(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("xtask-archive-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn an_archive_holds_program_pages_completions_rule_and_licences() {
        let scratch = scratch("whole");
        let workspace = Workspace::find().unwrap();
        let out = scratch.join("out");
        let program = program(&scratch, PROGRAM);
        // Twice: what is there is replaced.
        for _ in 0..2 {
            pack(&workspace, &program, "ihd-v1-here", &out).unwrap();
        }
        let listed = Command::new("tar")
            .arg("-tzf")
            .arg(out.join("ihd-v1-here.tar.gz"))
            .output()
            .unwrap();
        let listed = String::from_utf8(listed.stdout).unwrap();
        let files: BTreeSet<&str> = listed
            .lines()
            .filter(|line| !line.ends_with('/'))
            .filter_map(|line| line.strip_prefix("ihd-v1-here/"))
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
        fs::remove_dir_all(&scratch).unwrap();
    }

    #[test]
    fn a_program_that_fails_or_is_not_there_makes_no_archive() {
        let scratch = scratch("none");
        let workspace = Workspace::find().unwrap();
        let missing = pack(&workspace, &scratch.join("ihd"), "a", &scratch.join("out"));
        assert!(missing.unwrap_err().to_string().contains("build it first"));
        let program = program(&scratch, "#!/bin/sh\necho no such command >&2; exit 2\n");
        let failed = pack(&workspace, &program, "a", &scratch.join("out"));
        assert!(failed.unwrap_err().to_string().contains("no such command"));
        assert!(!scratch.join("out/a.tar.gz").exists());
        fs::remove_dir_all(&scratch).unwrap();
    }
}
