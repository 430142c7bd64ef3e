//! The compiler that builds the firmware: the active toolchain, with the board's target.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use crate::setup::install;
use crate::workspace::{Workspace, first_line};

/// What the controller board runs.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Finds the target's libraries, or has rustup install them.
///
/// # Errors
/// They are missing, and what to do.
pub fn ensure_target() -> anyhow::Result<()> {
    if !has_target() {
        let mut rustup = Command::new("rustup");
        let added = install(rustup.args(["target", "add", TARGET]));
        added.context("the firmware cannot be built")?;
        ensure!(has_target(), "the active toolchain has no {TARGET}");
    }
    Ok(())
}

fn has_target() -> bool {
    let mut rustc = Command::new("rustc");
    let folder = first_line(rustc.args(["--print", "target-libdir", "--target", TARGET]));
    // The folder is named even when it is missing.
    folder.is_some_and(|folder| Path::new(&folder).is_dir())
}

/// `cargo <subcommand>` set up for the board; the caller adds packages and what else it wants.
pub fn cargo(workspace: &Workspace, subcommand: &str) -> Command {
    let mut command = workspace.cargo([subcommand, "--target", TARGET]);
    command.arg("--target-dir");
    command.arg(workspace.target.join("firmware"));
    // Either would silently replace the linker arguments of .cargo/config.toml.
    command.env_remove("RUSTFLAGS");
    command.env_remove("CARGO_ENCODED_RUSTFLAGS");
    // Without it defmt keeps errors alone, whatever docs/board.md says of the log's lines.
    command.env("DEFMT_LOG", "info");
    command
}
