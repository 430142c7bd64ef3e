//! QEMU's Arm system emulator: found, installed, or unpacked beside the build.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use crate::setup::{apt_get, install, say};
use crate::toolchain::first_line;
use crate::workspace::Workspace;

const EMULATOR: &str = "qemu-system-arm";
/// Debian's package of it, and Ubuntu's.
const PACKAGE: &str = "qemu-system-arm";

/// A program that runs the emulator, installed if need be.
pub fn find(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let beside = workspace.target_dir().join("tools/qemu");
    let script = beside.join(EMULATOR);
    for program in [PathBuf::from(EMULATOR), script.clone()] {
        if starts(&program) {
            return Ok(program);
        }
    }
    let Err(refused) = apt_get(&[PACKAGE]) else {
        return found(EMULATOR.into());
    };
    say(&format!(
        "{refused:#}; unpacking the packages into {} instead, where they disturb nothing",
        beside.display()
    ));
    unpack(&beside, &script).with_context(|| {
        format!("{EMULATOR} is missing: install QEMU's Arm system emulator ({refused:#})")
    })?;
    found(script)
}

fn starts(program: &Path) -> bool {
    match first_line(Command::new(program).arg("--version")) {
        Some(version) => {
            say(&format!("emulator: {version}"));
            true
        }
        None => false,
    }
}

fn found(program: PathBuf) -> anyhow::Result<PathBuf> {
    if !starts(&program) {
        bail!("{} does not start", program.display());
    }
    Ok(program)
}

/// Unpacks the emulator and the libraries that this machine lacks into a folder, and writes a script
/// that starts it. For machines on which something installed conflicts with the package (backports of
/// qemu-utils do with the QEMU of the same Debian).
fn unpack(folder: &Path, script: &Path) -> anyhow::Result<()> {
    let (archives, root) = (folder.join("archives"), folder.join("root"));
    for dir in [&archives.join("partial"), &root] {
        fs::create_dir_all(dir).with_context(|| dir.display().to_string())?;
    }
    install(
        Command::new("apt-get")
            .args(["install", "--download-only", "--yes"])
            .arg("--no-install-recommends")
            .arg("-o")
            .arg(format!("Dir::Cache::archives={}", archives.display()))
            .arg(PACKAGE)
            .env("DEBIAN_FRONTEND", "noninteractive"),
    )?;
    for entry in fs::read_dir(&archives).context("no archives")? {
        let package = entry?.path();
        if package.extension().is_some_and(|suffix| suffix == "deb") {
            install(Command::new("dpkg-deb").arg("-x").args([&package, &root]))?;
        }
    }
    fs::remove_dir_all(&archives).context("cannot remove the archives")?;
    let libraries: Vec<_> = library_folders(&root)?
        .iter()
        .map(|dir| dir.display().to_string())
        .collect();
    let text = format!(
        "#!/bin/sh\nLD_LIBRARY_PATH='{}' exec '{root}/usr/bin/{EMULATOR}' -L '{root}/usr/share/qemu' \"$@\"\n",
        libraries.join(":"),
        root = root.display()
    );
    fs::write(script, text).with_context(|| script.display().to_string())?;
    install(Command::new("chmod").arg("+x").arg(script))
}

/// `lib/ARCH-linux-gnu` and `usr/lib/ARCH-linux-gnu` under an unpacked root.
fn library_folders(root: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut folders = Vec::new();
    for lib in [root.join("lib"), root.join("usr/lib")] {
        // A root without one of the two is complete all the same.
        let Ok(entries) = fs::read_dir(&lib) else {
            continue;
        };
        for entry in entries {
            let path = entry?.path();
            if path.to_string_lossy().ends_with("-linux-gnu") {
                folders.push(path);
            }
        }
    }
    folders.sort();
    Ok(folders)
}
