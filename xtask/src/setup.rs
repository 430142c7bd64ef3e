//! Finds or installs what the build needs, and says what was done or what to do by hand.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use clap::ValueEnum;

use crate::toolchain::{FirmwareToolchain, TARGET};
use crate::workspace::{Workspace, first_line, run};

const DEBIAN_PACKAGES: [&str; 2] = ["rustc-web", "rust-web-src"];

/// Which compiler the user wants for the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Wanted {
    /// rustup's if it has or can get the target, else Debian's
    Auto,
    /// The active toolchain with its target
    Rustup,
    /// Debian's rustc-web and rust-web-src
    DebianWeb,
}

/// Finds or installs what cargo needs beside itself.
pub fn tools(workspace: &Workspace) -> anyhow::Result<()> {
    let components = ["fmt", "clippy"].map(|tool| component(workspace, tool));
    let nextest = first_line(&mut workspace.cargo(["nextest", "--version"]));
    let nextest = nextest.context("the tests need `cargo install cargo-nextest --locked`")?;
    say(&format!("tests: {nextest}"));
    components.into_iter().collect()
}

/// The firmware's compiler, installed if need be: first rustup's target, because it is the smaller and the official one.
pub fn firmware_toolchain(wanted: Wanted) -> anyhow::Result<FirmwareToolchain> {
    let mut tried = String::new();
    if wanted != Wanted::DebianWeb {
        let found = FirmwareToolchain::rustup().or_else(|lacks| {
            let mut rustup = Command::new("rustup");
            install(rustup.args(["target", "add", TARGET])).context(lacks)?;
            FirmwareToolchain::rustup()
        });
        match found {
            Ok(toolchain) => return Ok(toolchain),
            Err(why) => tried += &format!("  rustup: {why:#}\n"),
        }
    }
    if wanted != Wanted::Rustup {
        let found = FirmwareToolchain::debian_web().or_else(|lacks| {
            apt_get(&DEBIAN_PACKAGES).context(lacks)?;
            FirmwareToolchain::debian_web()
        });
        match found {
            Ok(toolchain) => return Ok(toolchain),
            Err(why) => tried += &format!("  Debian: {why:#}\n"),
        }
    }
    bail!(
        "no compiler for {TARGET}, so the firmware cannot be built.\n{tried}Do one of these by hand, then run `cargo \
         xtask setup` again:\n  rustup target add {TARGET}\n  (Debian, as root) apt-get install {}",
        DEBIAN_PACKAGES.join(" ")
    );
}

/// Makes sure that `cargo fmt` or `cargo clippy` is there. rust-toolchain.toml names both, but rustup does not
/// install them on its own where its automatic installation is switched off.
fn component(workspace: &Workspace, tool: &str) -> anyhow::Result<()> {
    let present = || first_line(&mut workspace.cargo([tool, "--version"]));
    if present().is_none() {
        let name = if tool == "fmt" { "rustfmt" } else { tool };
        install(Command::new("rustup").args(["component", "add", name]))?;
    }
    let version = present().with_context(|| format!("`cargo {tool}` is missing; install it"))?;
    say(&format!("{tool}: {version}"));
    Ok(())
}

/// Installs Debian packages, removing none: some conflict with what may be somebody's choice.
pub fn apt_get(packages: &[&str]) -> anyhow::Result<()> {
    let apt = first_line(Command::new("apt-get").arg("--version"));
    if apt.is_none() || !Path::new("/etc/debian_version").exists() {
        bail!("this is not Debian, so nothing was installed");
    }
    if first_line(Command::new("id").arg("-u")).as_deref() != Some("0") {
        bail!("only root may run `apt-get install {}`", packages.join(" "));
    }
    install(Command::new("apt-get").arg("update"))?;
    let options = ["install", "--yes", "--no-install-recommends", "--no-remove"];
    install(Command::new("apt-get").args(options).args(packages))
}

/// Runs an installer in sight of the user.
pub fn install(command: &mut Command) -> anyhow::Result<()> {
    // rustup shows a backtrace of itself under RUST_BACKTRACE, which explains nothing here.
    command.env_remove("RUST_BACKTRACE").stdin(Stdio::null());
    run(command.env("DEBIAN_FRONTEND", "noninteractive"))
}

/// One line about what set-up found or does.
pub fn say(line: &str) {
    println!("set-up: {line}");
}
