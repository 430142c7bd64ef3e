//! Finds or installs what the build needs, and says what was done or what to do by hand.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use clap::ValueEnum;

use crate::emulator;
use crate::toolchain::{FirmwareToolchain, Found, TARGET, first_line, on_path};
use crate::workspace::{Workspace, spelled};

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

/// Prepares everything; returns the compiler that builds the firmware.
pub fn run(workspace: &Workspace, wanted: Wanted) -> anyhow::Result<FirmwareToolchain> {
    let components = ["fmt", "clippy"].map(|tool| component(workspace, tool));
    let nextest = has_nextest(workspace);
    say(if nextest {
        "tests: cargo-nextest"
    } else {
        "tests: cargo test (faster with `cargo install cargo-nextest --locked`)"
    });
    let qemu = emulator::find(workspace);
    let firmware = firmware_toolchain(wanted);
    if let Ok(toolchain) = &firmware {
        say(&format!("firmware: {}", toolchain.describe()));
    }
    // A missing formatter must not keep the firmware's compiler from being looked for.
    components
        .into_iter()
        .collect::<anyhow::Result<Vec<()>>>()?;
    qemu?;
    firmware
}

/// Whether `cargo nextest` is installed.
pub fn has_nextest(workspace: &Workspace) -> bool {
    first_line(&mut workspace.cargo(["nextest", "--version"])).is_some()
}

/// The firmware's compiler, installed if need be: first rustup's target, because it is the smaller and the official one.
pub fn firmware_toolchain(wanted: Wanted) -> anyhow::Result<FirmwareToolchain> {
    let mut tried = Vec::new();
    if wanted != Wanted::DebianWeb {
        match find_or_install(Found::rustup, add_target) {
            Ok(toolchain) => return Ok(toolchain),
            Err(why) => tried.push(format!("rustup: {why:#}")),
        }
    }
    if wanted != Wanted::Rustup {
        match find_or_install(Found::debian_web, install_debian) {
            Ok(toolchain) => return Ok(toolchain),
            Err(why) => tried.push(format!("Debian: {why:#}")),
        }
    }
    bail!(
        "no compiler for {TARGET}, so the firmware cannot be built.\n  {}\nDo one of these by hand, then run `cargo \
         xtask setup` again:\n  rustup target add {TARGET}\n  (Debian, as root) apt-get install {}",
        tried.join("\n  "),
        DEBIAN_PACKAGES.join(" ")
    );
}

fn find_or_install(
    choose: impl Fn(&Found) -> Result<FirmwareToolchain, String>,
    install: impl Fn() -> anyhow::Result<()>,
) -> anyhow::Result<FirmwareToolchain> {
    if let Ok(toolchain) = choose(&Found::on_this_machine()) {
        return Ok(toolchain);
    }
    install()?;
    choose(&Found::on_this_machine()).map_err(anyhow::Error::msg)
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

fn add_target() -> anyhow::Result<()> {
    install(Command::new("rustup").args(["target", "add", TARGET]))
}

fn install_debian() -> anyhow::Result<()> {
    let why_not = Found::on_this_machine().debian_web();
    let lacks = why_not.err().unwrap_or_default();
    apt_get(&DEBIAN_PACKAGES).with_context(|| lacks)
}

/// Installs Debian packages, removing none: some conflict with what may be somebody's choice.
pub fn apt_get(packages: &[&str]) -> anyhow::Result<()> {
    let has_apt = on_path("apt-get").iter().any(|path| path.is_file());
    if !has_apt || !Path::new("/etc/debian_version").exists() {
        bail!("this is not Debian, so nothing was installed");
    }
    if first_line(Command::new("id").arg("-u")).as_deref() != Some("0") {
        bail!("only root may run `apt-get install {}`", packages.join(" "));
    }
    install(Command::new("apt-get").arg("update"))?;
    let mut apt = Command::new("apt-get");
    apt.args(["install", "--yes", "--no-install-recommends", "--no-remove"])
        .args(packages)
        .env("DEBIAN_FRONTEND", "noninteractive");
    install(&mut apt)
}

/// Runs an installer in sight of the user; its own words say why it failed.
pub fn install(command: &mut Command) -> anyhow::Result<()> {
    let line = spelled(command);
    say(&format!("running `{line}`"));
    // rustup shows a backtrace of itself under RUST_BACKTRACE, which explains nothing here.
    let status = command
        .env_remove("RUST_BACKTRACE")
        .stdin(Stdio::null())
        .status()
        .with_context(|| format!("`{line}` could not be started"))?;
    if !status.success() {
        bail!("`{line}` failed ({status})");
    }
    Ok(())
}

/// One line about what set-up found or does.
pub fn say(line: &str) {
    println!("set-up: {line}");
}
