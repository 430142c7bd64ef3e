//! Compiler of the firmware: the active toolchain, with the board's target.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use crate::setup::install;
use crate::workspace::{Workspace, first_line};

/// Target of the controller board.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Finds the target's libraries, or has rustup install them.
///
/// # Errors
/// If they are missing, with a remedy.
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
    // The folder is printed even if it is missing.
    folder.is_some_and(|folder| Path::new(&folder).is_dir())
}

/// Returns `cargo <subcommand>` set up for the board; the caller adds packages and other arguments.
pub fn cargo(workspace: &Workspace, subcommand: &str) -> Command {
    for_board(workspace, workspace.cargo([subcommand]))
}

/// The same with Clippy's lints, of which each is an error.
pub fn linting(workspace: &Workspace, subcommand: &str) -> Command {
    for_board(workspace, workspace.linting(subcommand))
}

fn for_board(workspace: &Workspace, mut command: Command) -> Command {
    command.args(["--target", TARGET, "--target-dir"]);
    command.arg(workspace.target.join("firmware"));
    // Either would silently replace the linker arguments of .cargo/config.toml.
    command.env_remove("RUSTFLAGS");
    command.env_remove("CARGO_ENCODED_RUSTFLAGS");
    // Without it defmt only keeps errors, contrary to docs/board.md.
    command.env("DEFMT_LOG", "info");
    command
}
