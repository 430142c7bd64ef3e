//! The emulated STM32G474 in tests/stm32g474, a workspace of its own: its build wants cmake and libclang for Unicorn.

use std::path::Path;
use std::process::Command;

use anyhow::Context;

use crate::setup::{apt_get, install, say};
use crate::workspace::{Workspace, first_line, run};

const MANIFEST: [&str; 2] = ["--manifest-path", "tests/stm32g474/Cargo.toml"];

/// PyPI's packages of the tools, and Debian's, where there is no Python.
const PYPI: [&str; 2] = ["cmake", "libclang"];
const DEBIAN: [&str; 2] = ["cmake", "libclang-dev"];

/// Finds or installs what Unicorn's build needs.
pub fn tools(on: &Workspace) -> anyhow::Result<()> {
    let folder = on.target.join("tools/unicorn");
    if !folder.join("clang/native").is_dir() && !debian_has_both() {
        let mut pip = Command::new("python3");
        pip.args(["-m", "pip", "install", "--quiet", "--target"]);
        install(pip.arg(&folder).args(PYPI)).or_else(|why| apt_get(&DEBIAN).context(why))?;
    }
    let cmake = first_line(command_with_tools(on, "cmake").arg("--version"));
    say(&format!(
        "Unicorn's build: {}",
        cmake.context("cmake does not start")?
    ));
    Ok(())
}

fn debian_has_both() -> bool {
    let mut query = Command::new("dpkg-query");
    first_line(query.args(["--show", DEBIAN[0], DEBIAN[1]])).is_some()
}

/// A program with cmake on its path, and libclang with the compiler's own headers, which PyPI's lacks.
fn command_with_tools(on: &Workspace, program: &str) -> Command {
    let mut command = if program == "cargo" {
        on.cargo([""; 0])
    } else {
        Command::new(program)
    };
    let folder = on.target.join("tools/unicorn");
    if folder.is_dir() {
        let path = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{}:{path}", folder.join("bin").display()));
        command
            .env("PYTHONPATH", &folder)
            .env("LIBCLANG_PATH", folder.join("clang/native"));
        let headers = first_line(Command::new("cc").arg("-print-file-name=include"));
        command.env(
            "BINDGEN_EXTRA_CLANG_ARGS",
            format!("-I{}", headers.unwrap_or_default()),
        );
    }
    command.env("CARGO_TARGET_DIR", on.target.join("stm32g474"));
    command
}

/// `cargo <subcommand>` in that workspace.
pub fn cargo(on: &Workspace, subcommand: &str) -> Command {
    let mut command = command_with_tools(on, "cargo");
    command.arg(subcommand).args(MANIFEST);
    command
}

/// Formatting, clippy and the tests with the image.
pub fn test(on: &Workspace, image: &Path) -> anyhow::Result<()> {
    tools(on)?;
    run(cargo(on, "fmt").arg("--check"))?;
    run(cargo(on, "clippy").args(["--all-targets", "--", "-D", "warnings"]))?;
    let mut test = cargo(on, "test");
    test.args(["--lib", "--bins", "--test", "it", "--test", "usb_board"]);
    test.args(["--no-fail-fast", "--", "--nocapture"]);
    run(test.env("IHD_STM32G474_IMAGE", image))
}

/// The board as a process, with the link on TCP.
pub fn hob(on: &Workspace, image: &Path, arguments: &[String]) -> anyhow::Result<()> {
    tools(on)?;
    let mut hob = cargo(on, "run");
    hob.args(["--quiet", "--bin", "hob", "--", "--image"])
        .arg(image);
    run(hob.args(arguments))
}
