//! QEMU's system emulators: found, installed, or unpacked beside the build.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;

use crate::setup::{apt_get, install, say};
use crate::workspace::{Workspace, first_line};

/// Debian's package and the program in it of the emulator for the firmware's image.
pub const ARM: [&str; 2] = ["qemu-system-arm", "qemu-system-arm"];

/// The same of the emulator for a Linux that boards are connected to.
pub const X86: [&str; 2] = ["qemu-system-x86", "qemu-system-x86_64"];

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
pub fn find(workspace: &Workspace, [package, program]: [&str; 2]) -> anyhow::Result<PathBuf> {
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
    let mut unpack = Command::new(workspace.root.join("xtask/unpack"));
    unpack.args([package, program]).arg(&beside);
    install(&mut unpack)
        .with_context(|| format!("{program} is missing: install {package} ({refused:#})"))?;
    starts(script)
}

fn starts(program: PathBuf) -> anyhow::Result<PathBuf> {
    let version = first_line(Command::new(&program).arg("--version"));
    let version = version.with_context(|| format!("{program:?} does not start"))?;
    say(&format!("emulator: {version}"));
    Ok(program)
}
