//! Where the workspace is, and how xtask starts cargo and other programs.

use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use cargo_metadata::MetadataCommand;

/// Beside each crate's own: debug probes, and the model of one.
const FEATURES: &str = "ihd/fleet,ihd/probe,ihd-debug-port/probe";

/// The checkout that xtask was started in.
pub struct Workspace {
    /// The folder of the workspace's Cargo.toml.
    pub root: PathBuf,
    /// Where host builds go.
    pub target: PathBuf,
}

impl Workspace {
    /// The workspace that holds xtask's manifest.
    pub fn find() -> anyhow::Result<Self> {
        // At run time first: a built xtask may have moved together with its checkout.
        let xtask = env::var_os("CARGO_MANIFEST_DIR");
        let xtask = xtask.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
        let root = Path::new(&xtask).parent().filter(|dir| dir.is_dir());
        let root = root.context("no workspace: start this with `cargo xtask` in the checkout")?;
        // In the root, like every later cargo: a relative CARGO_TARGET_DIR then means the same folder.
        let mut metadata = MetadataCommand::new();
        let metadata = metadata.current_dir(root).no_deps().exec()?;
        Ok(Self {
            root: metadata.workspace_root.into(),
            target: metadata.target_directory.into(),
        })
    }

    /// `cargo <subcommand>` on the whole workspace with the features that every step builds, and the rest of its line: what one step
    /// has built then serves the next.
    pub fn whole(&self, subcommand: &str, rest: &str) -> Command {
        let mut command = self.cargo(subcommand.split(' '));
        command.args(["--workspace", "--features", FEATURES]);
        command.args(rest.split(' '));
        command
    }

    /// A cargo that starts in the workspace root and knows nothing of xtask's own package.
    pub fn cargo<S: AsRef<OsStr>>(&self, args: impl IntoIterator<Item = S>) -> Command {
        let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = Command::new(cargo);
        command.current_dir(&self.root).args(args);
        for (name, _) in env::vars_os() {
            if name.to_str().is_some_and(describes_xtask) {
                command.env_remove(name);
            }
        }
        command
    }
}

/// What `cargo run` tells the program it starts about that program. Handed on to a nested cargo it would describe the
/// wrong package, and build scripts that watch it would rebuild for nothing.
fn describes_xtask(variable: &str) -> bool {
    let named = [
        "CARGO_BIN_NAME",
        "CARGO_CRATE_NAME",
        "CARGO_PRIMARY_PACKAGE",
    ];
    let mut groups = ["CARGO_PKG_", "CARGO_MANIFEST_"].into_iter();
    named.contains(&variable) || groups.any(|start| variable.starts_with(start))
}

/// Runs a command in sight of the user; its own words say why it failed.
pub fn run(command: &mut Command) -> anyhow::Result<()> {
    let line = spelled(command);
    println!("$ {line}");
    let status = command.status();
    let status = status.with_context(|| format!("could not start `{line}`"))?;
    ensure!(status.success(), "`{line}` failed ({status}); see above");
    Ok(())
}

/// The first line that a command prints, if it succeeds.
pub fn first_line(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let line = text.lines().next()?.trim();
    (output.status.success() && !line.is_empty()).then(|| line.to_owned())
}

/// How a command looks when typed: what a failure message names.
pub fn spelled(command: &Command) -> String {
    let program = Path::new(command.get_program()).file_stem();
    let words = program.into_iter().chain(command.get_args());
    let words: Vec<_> = words.map(OsStr::to_string_lossy).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_variables_about_xtask_are_kept_from_children() {
        let about = ["CARGO_PKG_NAME", "CARGO_MANIFEST_DIR"];
        assert!(about.into_iter().all(describes_xtask));
        let others = ["CARGO_HOME", "CARGO_TARGET_DIR", "RUSTUP_TOOLCHAIN"];
        assert!(!others.into_iter().any(describes_xtask));
    }

    #[test]
    fn a_command_is_spelled_without_its_folder() {
        let mut command = Command::new("/opt/rust/bin/cargo");
        command.args(["fmt", "--all"]);
        assert_eq!(spelled(&command), "cargo fmt --all");
    }
}
