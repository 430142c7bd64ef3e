//! Location of the workspace, and start of cargo and other programs.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStderr, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::{env, fs};

use anyhow::{Context, ensure};
use cargo_metadata::MetadataCommand;

/// Features beside each crate's own; the same in all steps, so that they share build results.
const FEATURES: &str = "ihd/fleet,ihd/probe,ihd-debug-port/probe";

/// Packages compiled so far, with their target, and how often.
static COMPILED: Mutex<BTreeMap<String, u32>> = Mutex::new(BTreeMap::new());

/// Checkout in which xtask was started.
pub struct Workspace {
    /// The folder of the workspace's Cargo.toml.
    pub root: PathBuf,
    /// Folder of host builds.
    pub target: PathBuf,
    /// Board file of every build; `None` for the one in the environment, or boards/reference.toml.
    pub board: Option<PathBuf>,
}

impl Workspace {
    /// Finds the workspace with xtask's manifest.
    pub fn find() -> anyhow::Result<Self> {
        // The run-time variable first: a built xtask may have moved together with its checkout.
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
            board: None,
        })
    }

    /// Returns `cargo <subcommand>` on the whole workspace with the features that every step builds, and the rest of its arguments.
    pub fn whole(&self, subcommand: &str, rest: &str) -> Command {
        let mut command = self.linting(subcommand);
        command.args(["--workspace", "--features", FEATURES]);
        command.args(rest.split_whitespace());
        command
    }

    /// Builds what the step "tests" builds, all at once if that step did not run, and returns a program of it.
    pub fn program(&self, name: &str) -> anyhow::Result<PathBuf> {
        run(&mut self.whole("test", "--lib --bins --tests --no-run --quiet"))?;
        let program = self.target.join("debug").join(name);
        Ok(program.with_extension(env::consts::EXE_EXTENSION))
    }

    /// Returns `cargo <subcommand>` that also lints: Clippy's compiler is rustc with more lints, so no second compilation is
    /// needed. A warning is an error. This is the mechanism of `cargo clippy`, for another subcommand than `check`.
    pub fn linting(&self, subcommand: &str) -> Command {
        let mut command = self.cargo(subcommand.split_whitespace());
        let sysroot = first_line(Command::new("rustc").args(["--print", "sysroot"]));
        let driver = Path::new(&sysroot.unwrap_or_default()).join("bin/clippy-driver");
        command.env("RUSTC_WORKSPACE_WRAPPER", driver);
        // Format expected by clippy-driver.
        let separator = "__CLIPPY_HACKERY__";
        command.env("CLIPPY_ARGS", ["-D", "warnings", ""].join(separator));
        command
    }

    /// Returns a cargo that starts in the workspace root without the variables of xtask's own package.
    pub fn cargo<S: AsRef<OsStr>>(&self, args: impl IntoIterator<Item = S>) -> Command {
        let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = Command::new(cargo);
        command.current_dir(&self.root).args(args);
        for (name, _) in env::vars_os() {
            if name.to_str().is_some_and(describes_xtask) {
                command.env_remove(name);
            }
        }
        command.env("CARGO_TARGET_DIR", &self.target);
        if let Some(board) = &self.board {
            command.env("IHD_BOARD", board);
        }
        command
    }

    /// Copies a newer Cargo.lock into the folder of another workspace, for the same versions; cargo adds that one's own.
    pub fn copy_lock(&self, folder: &Path) -> anyhow::Result<()> {
        let [from, to] = [&*self.root, folder].map(|folder| folder.join("Cargo.lock"));
        let changed = |path: &Path| path.metadata().and_then(|file| file.modified()).ok();
        if changed(&to) < changed(&from) {
            fs::copy(&from, &to).with_context(|| format!("cannot write {}", to.display()))?;
        }
        Ok(())
    }
}

/// Returns `true` for the variables by which `cargo run` describes the program that it starts. For a nested cargo they would
/// describe the wrong package, and build scripts that watch them would rebuild for nothing.
fn describes_xtask(variable: &str) -> bool {
    let named = [
        "CARGO_BIN_NAME",
        "CARGO_CRATE_NAME",
        "CARGO_PRIMARY_PACKAGE",
    ];
    let mut groups = ["CARGO_PKG_", "CARGO_MANIFEST_"].into_iter();
    named.contains(&variable) || groups.any(|start| variable.starts_with(start))
}

/// Runs a command with its output visible; the output has the reason of a failure.
pub fn run(command: &mut Command) -> anyhow::Result<()> {
    let line = spelled(command);
    println!("$ {line}");
    let mut words = command.get_args().skip_while(|word| *word != "--target");
    let target = words.nth(1).unwrap_or("host".as_ref());
    let target = target.to_string_lossy().into_owned();
    if std::io::stderr().is_terminal() {
        command.env("CARGO_TERM_COLOR", "always");
    }
    let child = command.stderr(Stdio::piped()).spawn();
    let mut child = child.with_context(|| format!("could not start `{line}`"))?;
    if let Some(stderr) = child.stderr.take() {
        pass_on(stderr, &target)?;
    }
    let status = child.wait()?;
    ensure!(status.success(), "`{line}` failed ({status}); see above");
    Ok(())
}

/// Runs a command whose output is shown in one piece when it has ended.
pub fn run_apart(mut command: Command) -> anyhow::Result<()> {
    let line = spelled(&command);
    let (mut output, writer) = std::io::pipe()?;
    let child = command.stdout(writer.try_clone()?).stderr(writer).spawn();
    let mut child = child.with_context(|| format!("could not start `{line}`"))?;
    // Its ends of the pipe, without which the output would not end.
    drop(command);
    let mut text = String::new();
    output.read_to_string(&mut text)?;
    print!("{text}");
    text.lines().for_each(|line| count(line, "host"));
    let status = child.wait()?;
    ensure!(status.success(), "`{line}` failed ({status}); see above");
    Ok(())
}

/// Copies a command's messages to standard error and counts the packages that cargo compiles.
fn pass_on(stderr: ChildStderr, target: &str) -> anyhow::Result<()> {
    let mut lines = BufReader::new(stderr);
    let mut line = Vec::new();
    while lines.read_until(b'\n', &mut line)? > 0 {
        std::io::stderr().write_all(&line)?;
        count(&String::from_utf8_lossy(&line), target);
        line.clear();
    }
    Ok(())
}

/// Counts the package that cargo compiles, if the line says so.
fn count(line: &str, target: &str) {
    if let Some(package) = compiled(line) {
        let mut all = COMPILED.lock().unwrap_or_else(PoisonError::into_inner);
        *all.entry(format!("{package} ({target})")).or_default() += 1;
    }
}

/// Name and version in cargo's line about a compiled package, coloured or not.
fn compiled(line: &str) -> Option<String> {
    let (before, after) = line.split_once("Compiling")?;
    let mut words = after
        .trim_start_matches(|c: char| c != ' ')
        .split_whitespace();
    let is_cargos = before.trim().is_empty() || before.contains('\u{1b}');
    let (name, version) = (words.next()?, words.next()?);
    (is_cargos && version.starts_with('v')).then(|| format!("{name} {version}"))
}

/// Text with the number of compiled packages, and those compiled more than once for one target.
pub fn compilations() -> String {
    let all = COMPILED.lock().unwrap_or_else(PoisonError::into_inner);
    let again: Vec<_> = all.iter().filter(|(_, times)| **times > 1).collect();
    let names: Vec<_> = again.iter().map(|(name, _)| name.as_str()).collect();
    let (all, again, twice) = (all.len(), again.len(), names.join(", "));
    format!("{all} packages compiled; more than once: {again} {twice}")
}

/// First line that a command prints, if it succeeds.
pub fn first_line(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let line = text.lines().next()?.trim();
    (output.status.success() && !line.is_empty()).then(|| line.to_owned())
}

/// Command line as typed, for messages.
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
    fn cargos_lines_about_packages_are_counted_and_no_others() {
        let package = Some("syn v2.0.119".to_owned());
        assert_eq!(compiled("   Compiling syn v2.0.119"), package);
        let coloured = "\u{1b}[1m\u{1b}[92m   Compiling\u{1b}[0m syn v2.0.119\n";
        assert_eq!(compiled(coloured), package);
        let ihd = compiled("   Compiling ihd v0.1.0 (/work/host/ihd)");
        assert_eq!(ihd, Some("ihd v0.1.0".into()));
        assert_eq!(compiled("a test says: Compiling takes long"), None);
        assert_eq!(compiled("    Finished `test` profile"), None);
    }

    #[test]
    fn a_command_is_spelled_without_its_folder() {
        let mut command = Command::new("/opt/rust/bin/cargo");
        command.args(["fmt", "--all"]);
        assert_eq!(spelled(&command), "cargo fmt --all");
    }
}
