//! Contents of a release's archive, as packaging/archive makes it of stand-ins for the programs.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use crate::document_links::faults;

/// Stands in for the program that writes the pages: a page, and a line for each shell.
const PAGES: &str = "#!/bin/sh\n\
    mkdir -p \"$1/man/man1\" \"$1/completions\" && echo page > \"$1/man/man1/ihd.1\"\n\
    for file in ihd.bash _ihd ihd.fish ihd.ps1 ihd.elv; do echo line > \"$1/completions/$file\"; done\n";

/// Packs `folder/ihd` with the pages of `folder/pages` into `folder/out`.
fn pack(folder: &Path) -> Output {
    pack_program(folder, "ihd")
}

fn pack_program(folder: &Path, program: &str) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/archive");
    let mut command = Command::new(script);
    command.args([folder.join(program), folder.join("pages")]);
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

/// Makes stand-ins for everything that lies beside a program of this ending.
fn make_release(folder: &Path, ending: &str) {
    for name in ["ihd", "ihd-fleet"] {
        make_program(folder, &format!("{name}{ending}"), "#!/bin/sh\n");
    }
    fs::write(folder.join("THIRD-PARTY-LICENCES"), "texts\n").unwrap();
    make_program(folder, "pages", PAGES);
}

/// Lines that a program prints about a file.
fn listed(program: &str, arguments: &[&str], file: &Path) -> Vec<String> {
    let output = Command::new(program).args(arguments).arg(file).output();
    let text = String::from_utf8(output.unwrap().stdout).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn an_archive_holds_program_pages_completions_rule_and_licences() {
    let folder = tempfile::tempdir().unwrap();
    make_release(folder.path(), "");
    // Twice: what is there is replaced.
    for _ in 0..2 {
        let packed = pack(folder.path());
        assert!(packed.status.success(), "{packed:?}");
    }
    let out = folder.path().join("out");
    let archive = out.join("ihd-v1-here.tar.gz");
    let files = listed("tar", &["-tzf"], &archive);
    let files = files.iter().filter_map(|line| {
        let file = line.strip_prefix("ihd-v1-here/")?;
        (!file.is_empty() && !file.ends_with('/') && !file.starts_with("docs/")).then_some(file)
    });
    let files: BTreeSet<&str> = files.collect();
    let expected = BTreeSet::from([
        "CHANGELOG.md",
        "LICENSE-APACHE",
        "LICENSE-MIT",
        "README.md",
        "THIRD-PARTY-LICENCES",
        "completions/_ihd",
        "completions/ihd.bash",
        "completions/ihd.elv",
        "completions/ihd.fish",
        "completions/ihd.ps1",
        "ihd",
        "ihd-fleet",
        "man/man1/ihd.1",
        "packaging/nats/ihd-nats.service",
        "packaging/systemd/ihd.service",
    ]);
    assert_eq!(files, expected);
    let unpacked = folder.path().join("unpacked");
    fs::create_dir(&unpacked).unwrap();
    let mut tar = Command::new("tar");
    let tar = tar.arg("-xzf").arg(&archive).arg("-C").arg(&unpacked);
    assert!(tar.status().unwrap().success());
    let (faults, documents) = faults(&unpacked);
    assert!(documents > 15, "{documents} documents");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1, "the folder is gone");
}

/// Task Scheduler wants UTF-16, the command interpreter its own ends of lines. The installer is made of this (packaging/windows/msi).
#[test]
fn an_archive_for_windows_holds_what_its_installer_starts() {
    let folder = tempfile::tempdir().unwrap();
    make_release(folder.path(), ".exe");
    let packed = pack_program(folder.path(), "ihd.exe");
    assert!(packed.status.success(), "{packed:?}");
    let mut unpack = Command::new("python3");
    unpack.args(["-m", "zipfile", "-e", "out/ihd-v1-here.zip", "."]);
    assert!(unpack.current_dir(&folder).status().unwrap().success());
    let read = |name: &str| fs::read(folder.path().join("ihd-v1-here").join(name)).unwrap();
    for program in ["ihd.exe", "ihd-fleet.exe"] {
        assert_eq!(read(program), b"#!/bin/sh\n");
    }
    assert!(read("README.md").starts_with(b"# ihd"));
    let task = read("ihd-task.xml");
    let units = task
        .chunks_exact(2)
        .map(|b| u16::from_le_bytes([b[0], b[1]]));
    let task = String::from_utf16(&units.collect::<Vec<_>>()).unwrap();
    assert!(task.starts_with("\u{feff}<?xml"), "{task}");
    let line = r#"\ihd\ihd-daemon.cmd" run"</Arguments>"#;
    assert!(task.contains(line), "{task}");
    let script = String::from_utf8(read("ihd-daemon.cmd")).unwrap();
    assert!(script.contains("trainer --daemon"));
    assert_eq!(script.matches('\n').count(), script.matches("\r\n").count());
}

#[test]
fn a_program_that_fails_or_is_not_there_makes_no_archive() {
    let folder = tempfile::tempdir().unwrap();
    let missing = pack(folder.path());
    assert!(!missing.status.success());
    assert!(String::from_utf8_lossy(&missing.stderr).contains("PROGRAM that was built"));
    make_release(folder.path(), "");
    let silent = PAGES.replace("echo line", "true");
    for program in ["#!/bin/sh\necho no such command >&2; exit 2\n", &silent] {
        make_program(folder.path(), "pages", program);
        assert!(!pack(folder.path()).status.success());
        let out = fs::read_dir(folder.path().join("out")).unwrap();
        assert_eq!(out.count(), 0);
    }
    make_release(folder.path(), "");
    fs::remove_file(folder.path().join("ihd-fleet")).unwrap();
    let half = pack(folder.path());
    assert!(!half.status.success());
    assert!(String::from_utf8_lossy(&half.stderr).contains("ihd-fleet"));
}

/// Debian's own paths; the documents' links hold where they lie then, and the configuration is the user's to keep.
#[test]
fn a_debian_package_puts_each_file_where_debian_looks_for_it() {
    if Command::new("dpkg-deb").arg("--version").output().is_err() {
        println!("skipped: no dpkg-deb");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    make_release(folder.path(), "");
    assert!(pack(folder.path()).status.success());
    let out = folder.path().join("out");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/deb");
    let make = |archive: &str| {
        let mut command = Command::new(&script);
        let made = command.arg(out.join(archive)).arg("1.2.3").arg(&out);
        let made = made.output().unwrap();
        assert!(made.status.success(), "{made:?}");
    };
    let cross_built = "ihd-v1-aarch64-unknown-linux-musl.tar.gz";
    fs::copy(out.join("ihd-v1-here.tar.gz"), out.join(cross_built)).unwrap();
    make(cross_built);
    fs::remove_file(out.join("ihd_1.2.3_arm64.deb")).unwrap();
    make("ihd-v1-here.tar.gz");
    let all = fs::read_dir(&out)
        .unwrap()
        .flatten()
        .map(|entry| entry.path());
    let package = all
        .into_iter()
        .find(|path| path.extension().is_some_and(|end| end == "deb"));
    let package = package.unwrap();
    let unpacked = folder.path().join("unpacked");
    let mut extract = Command::new("dpkg-deb");
    let extract = extract.arg("--extract").arg(&package).arg(&unpacked);
    assert!(extract.status().unwrap().success());
    for file in [
        "usr/bin/ihd",
        "usr/bin/ihd-fleet",
        "usr/lib/udev/rules.d/70-ihd.rules",
        "usr/share/man/man1/ihd.1.gz",
        "usr/share/bash-completion/completions/ihd",
        "usr/share/zsh/vendor-completions/_ihd",
        "usr/share/fish/vendor_completions.d/ihd.fish",
        "usr/share/doc/ihd/copyright",
        "usr/share/doc/ihd/THIRD-PARTY-LICENCES",
        "usr/share/doc/ihd/docs/daemon.md",
        "etc/ihd/ihd.toml",
    ] {
        assert!(unpacked.join(file).is_file(), "{file}");
    }
    let service = fs::read_to_string(unpacked.join("usr/lib/systemd/system/ihd.service")).unwrap();
    assert!(service.contains("ExecStart=/usr/bin/ihd trainer --daemon --config /etc/ihd/ihd.toml"));
    assert_eq!(faults(&unpacked).0, Vec::<String>::new());
    let kept = listed("dpkg-deb", &["--info"], &package).join("\n");
    assert!(
        kept.contains("conffiles") && kept.contains("Version: 1.2.3"),
        "{kept}"
    );
}
