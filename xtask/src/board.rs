//! The emulated STM32G474 in tests/stm32g474, outside the main workspace since Unicorn is GPL: its build needs cmake and libclang.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

use crate::pypi;
use crate::workspace::{Workspace, first_line, run};

/// Folder of the emulator in the checkout.
const FOLDER: &str = "tests/stm32g474";

/// Puts cmake on the command's path, and names libclang with the compiler's own headers, which PyPI's package lacks.
fn give_tools(on: &Workspace, command: &mut Command) -> anyhow::Result<()> {
    let folder = pypi::tools(on, "unicorn")?;
    let path = std::env::var("PATH").unwrap_or_default();
    let headers = first_line(Command::new("cc").arg("-print-file-name=include"));
    let headers = headers.context("no C compiler: `cc` does not start")?;
    command
        .env("PATH", format!("{}:{path}", folder.join("bin").display()))
        .env("PYTHONPATH", &folder)
        .env("LIBCLANG_PATH", folder.join("clang/native"))
        .env("BINDGEN_EXTRA_CLANG_ARGS", format!("-I{headers}"));
    Ok(())
}

/// Writes a workspace with the emulator as an additional member of the main one, and returns its manifest.
///
/// Cargo names build results by the package's place in its workspace and the features of the whole workspace. With the same members
/// and features the main workspace's results are used again: of 256 packages 20 are left, Unicorn's.
fn joined(on: &Workspace) -> anyhow::Result<PathBuf> {
    let folder = on.target.join("joined");
    fs::create_dir_all(&folder)?;
    let own = ["Cargo.toml", "Cargo.lock", "target", ".git"];
    let mut link = Command::new("ln");
    link.arg("-sfn");
    for entry in fs::read_dir(&on.root)? {
        let entry = entry?;
        if !own.iter().any(|own| entry.file_name() == *own) {
            link.arg(entry.path());
        }
    }
    let linked = link.arg(&folder).status().context("cannot start ln")?;
    ensure!(linked.success(), "cannot link into {}", folder.display());
    let text = fs::read_to_string(on.root.join("Cargo.toml"))?;
    let mut manifest: toml::Table = text.parse()?;
    let workspace = manifest["workspace"].as_table_mut();
    let workspace = workspace.context("no [workspace]")?;
    let members = workspace.get_mut("members");
    let members = members.and_then(toml::Value::as_array_mut);
    members.context("no members")?.push(FOLDER.into());
    workspace.remove("exclude");
    let (text, place) = (manifest.to_string(), folder.join("Cargo.toml"));
    // Clippy's compiler makes its results depend on this file's time.
    if fs::read_to_string(&place).ok().as_ref() != Some(&text) {
        fs::write(&place, text)?;
    }
    on.copy_lock(&folder)?;
    Ok(place)
}

/// `cargo <subcommand>` in the main workspace with the emulator, for the targets of the emulator that `rest` names.
pub fn cargo(on: &Workspace, subcommand: &str, rest: &str) -> anyhow::Result<Command> {
    let manifest = joined(on)?;
    let mut command = on.whole(subcommand, rest);
    give_tools(on, &mut command)?;
    command.arg("--manifest-path").arg(manifest);
    Ok(command)
}

/// Runs the tests of these targets of the emulator; `full` includes those of the full tier.
pub fn run_tests(on: &Workspace, targets: &[&str], full: bool) -> anyhow::Result<Command> {
    let profile = if full {
        "--profile full --run-ignored all"
    } else {
        "--profile default"
    };
    let names: Vec<_> = targets
        .iter()
        .map(|name| format!("--test {name}"))
        .collect();
    cargo(on, "nextest run", &format!("{} {profile}", names.join(" ")))
}

/// Checks the formatting and runs the tests with the image; `full` includes those of the full tier.
pub fn test(on: &Workspace, image: &Path, full: bool) -> anyhow::Result<()> {
    let manifest = joined(on)?;
    let mut format = on.cargo(["fmt", "--check", "--package", "ihd-stm32g474"]);
    run(format.arg("--manifest-path").arg(manifest))?;
    let mut test = run_tests(on, &["board_parts", "board", "usb_board"], full)?;
    run(test.env("IHD_STM32G474_IMAGE", image))
}

/// Runs the board as a process, with the link on TCP.
pub fn hob(on: &Workspace, image: &Path, arguments: &[String]) -> anyhow::Result<()> {
    run(&mut cargo(on, "build", "--bin hob")?)?;
    let mut hob = Command::new(on.target.join("debug/hob"));
    run(hob.arg("--image").arg(image).args(arguments))
}
