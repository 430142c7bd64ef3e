//! QEMU's Arm system emulator: found, installed, or unpacked beside the build.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::setup::{apt_get, install, say};
use crate::workspace::{Workspace, first_line};

/// The program, and Debian's and Ubuntu's package of it.
const EMULATOR: &str = "qemu-system-arm";

/// A program that runs the emulator, installed if need be.
pub fn find(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let beside = workspace.target.join("tools/qemu");
    let script = beside.join(EMULATOR);
    if let Ok(program) = starts(EMULATOR.into()).or_else(|_| starts(script.clone())) {
        return Ok(program);
    }
    let Err(refused) = apt_get(&[EMULATOR]) else {
        return starts(EMULATOR.into());
    };
    say(&format!(
        "{refused:#}; unpacking the packages into {} instead, where they disturb nothing",
        beside.display()
    ));
    unpack(&beside, &script).with_context(|| {
        format!("{EMULATOR} is missing: install QEMU's Arm system emulator ({refused:#})")
    })?;
    starts(script)
}

fn starts(program: PathBuf) -> anyhow::Result<PathBuf> {
    let version = first_line(Command::new(&program).arg("--version"));
    let version = version.with_context(|| format!("{program:?} does not start"))?;
    say(&format!("emulator: {version}"));
    Ok(program)
}

/// Unpacks the emulator and the libraries that this machine lacks into a folder, and writes a script
/// that starts it. For machines on which something installed conflicts with the package (backports of
/// qemu-utils do with the QEMU of the same Debian).
fn unpack(folder: &Path, script: &Path) -> anyhow::Result<()> {
    let (archives, root) = (folder.join("archives"), folder.join("root"));
    fs::create_dir_all(archives.join("partial"))?;
    fs::create_dir_all(&root)?;
    let mut download = Command::new("apt-get");
    download.args(["install", "--download-only", "--yes"]);
    download.args(["--no-install-recommends", "-o"]);
    download.arg(format!("Dir::Cache::archives={}", archives.display()));
    install(download.arg(EMULATOR))?;
    for entry in fs::read_dir(&archives).context("no archives")? {
        let package = entry?.path();
        if package.extension().is_some_and(|suffix| suffix == "deb") {
            install(Command::new("dpkg-deb").arg("-x").args([&package, &root]))?;
        }
    }
    fs::remove_dir_all(&archives).context("cannot remove the archives")?;
    // A folder that is not there does no harm on the search path.
    let text = format!(
        "#!/bin/sh\nlibraries=$(printf '%s:' '{root}'/lib/*-linux-gnu '{root}'/usr/lib/*-linux-gnu)\n\
         LD_LIBRARY_PATH=${{libraries%:}} exec '{root}/usr/bin/{EMULATOR}' -L '{root}/usr/share/qemu' \"$@\"\n",
        root = root.display()
    );
    fs::write(script, text).with_context(|| script.display().to_string())?;
    install(Command::new("chmod").arg("+x").arg(script))
}
