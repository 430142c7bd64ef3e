//! Set-up: finds or installs the tools of the build, and reports the result or a manual remedy.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::workspace::{Workspace, first_line, run};

/// Finds or installs the tools that cargo needs.
pub fn tools(workspace: &Workspace) -> anyhow::Result<()> {
    let components = ["fmt", "clippy"].map(|tool| component(workspace, tool));
    let nextest = first_line(&mut workspace.cargo(["nextest", "--version"]));
    let nextest = nextest.context("the tests need `cargo install cargo-nextest --locked`")?;
    say(&format!("tests: {nextest}"));
    components.into_iter().collect()
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

/// Finds a program or installs the Debian package that has it; returns its version.
///
/// # Errors
/// If it is missing, with a remedy.
pub fn program(name: &str, package: &str) -> anyhow::Result<String> {
    let version = || first_line(Command::new(name).arg("--version"));
    if let Some(version) = version() {
        return Ok(version);
    }
    let remedy = || format!("`{name}` is missing: install {package}");
    apt_get(&[package]).with_context(remedy)?;
    version().with_context(remedy)
}

/// Installs Debian packages, removing none: a conflicting package may be the user's choice.
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

/// Runs an installer with its output visible.
pub fn install(command: &mut Command) -> anyhow::Result<()> {
    // rustup would show a backtrace of itself under RUST_BACKTRACE, which is of no use here.
    command.env_remove("RUST_BACKTRACE").stdin(Stdio::null());
    run(command.env("DEBIAN_FRONTEND", "noninteractive"))
}

/// Prints one line about the set-up.
pub fn say(line: &str) {
    println!("set-up: {line}");
}
