//! QEMU's system emulators: found, installed, or unpacked beside the build.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;

use crate::setup::{apt_get, install, say};
use crate::workspace::{Workspace, first_line};

/// One of QEMU's emulators.
#[derive(Clone, Copy)]
pub struct Emulator {
    /// Package of Debian and Ubuntu.
    package: &'static str,
    program: &'static str,
}

/// Emulator for the firmware's image.
pub const ARM: Emulator = Emulator::new("qemu-system-arm", "qemu-system-arm");

/// Emulator for a Linux that boards are connected to.
pub const X86: Emulator = Emulator::new("qemu-system-x86", "qemu-system-x86_64");

impl Emulator {
    const fn new(package: &'static str, program: &'static str) -> Self {
        Self { package, program }
    }
}

/// Command for the machine on which the firmware's images run, with this semihosting, about to run `image`.
pub fn an386(qemu: &Path, semihosting: &str, image: &Path) -> Command {
    let mut command = Command::new(qemu);
    command
        .args(["-M", "mps2-an386", "-cpu", "cortex-m4", "-display", "none"])
        .args(["-serial", "null", "-monitor", "none"])
        .args(["-semihosting-config", semihosting, "-kernel"])
        .arg(image)
        .stdin(Stdio::null());
    command
}

/// Returns a program that runs the emulator, installing it if necessary.
pub fn find(workspace: &Workspace, emulator: Emulator) -> anyhow::Result<PathBuf> {
    let Emulator { package, program } = emulator;
    let beside = workspace.target.join("tools").join(package);
    let script = beside.join(program);
    if let Ok(program) = starts(program.into()).or_else(|_| starts(script.clone())) {
        return Ok(program);
    }
    let Err(refused) = apt_get(&[package]) else {
        return starts(program.into());
    };
    say(&format!(
        "{refused:#}; unpacking the packages into {} instead, where they disturb nothing",
        beside.display()
    ));
    unpack(&beside, &script, emulator)
        .with_context(|| format!("{program} is missing: install {package} ({refused:#})"))?;
    starts(script)
}

fn starts(program: PathBuf) -> anyhow::Result<PathBuf> {
    let version = first_line(Command::new(&program).arg("--version"));
    let version = version.with_context(|| format!("{program:?} does not start"))?;
    say(&format!("emulator: {version}"));
    Ok(program)
}

/// Unpacks the emulator and the libraries that this machine lacks into a folder, and writes a script that starts it. This is for
/// machines on which an installed package conflicts with it (backports of qemu-utils do with the QEMU of the same Debian).
fn unpack(folder: &Path, script: &Path, emulator: Emulator) -> anyhow::Result<()> {
    let Emulator { package, program } = emulator;
    let (archives, root) = (folder.join("archives"), folder.join("root"));
    fs::create_dir_all(archives.join("partial"))?;
    fs::create_dir_all(&root)?;
    let mut download = Command::new("apt-get");
    download.args(["install", "--download-only", "--yes"]);
    download.args(["--no-install-recommends", "-o"]);
    download.arg(format!("Dir::Cache::archives={}", archives.display()));
    install(download.arg(package))?;
    for entry in fs::read_dir(&archives).context("no archives")? {
        let archive = entry?.path();
        if archive.extension().is_some_and(|suffix| suffix == "deb") {
            install(Command::new("dpkg-deb").arg("-x").args([&archive, &root]))?;
        }
    }
    fs::remove_dir_all(&archives).context("cannot remove the archives")?;
    // A missing folder on the search path does no harm.
    let text = format!(
        "#!/bin/sh\nlibraries=$(printf '%s:' '{root}'/lib/*-linux-gnu '{root}'/usr/lib/*-linux-gnu)\n\
         LD_LIBRARY_PATH=${{libraries%:}} exec '{root}/usr/bin/{program}' \
         -L '{root}/usr/share/qemu' -L '{root}/usr/share/seabios' \"$@\"\n",
        root = root.display()
    );
    fs::write(script, text).with_context(|| script.display().to_string())?;
    install(Command::new("chmod").arg("+x").arg(script))
}
