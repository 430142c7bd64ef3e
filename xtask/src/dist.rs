//! `cargo xtask dist`: a release of this checkout, made by packaging/dist; `cargo xtask docs`: the documents as a book.

use std::path::Path;
use std::process::Command;

use crate::setup::{install, program};
use crate::workspace::{Workspace, first_line, run};

/// Makes target/dist with the firmware's `image` in the program.
pub fn make(on: &Workspace, image: &Path) -> anyhow::Result<()> {
    let target = format!("{}-unknown-linux-musl", std::env::consts::ARCH);
    let targets = ["target", "add", &target, "x86_64-pc-windows-gnu"];
    install(Command::new("rustup").args(targets))?;
    program("musl-gcc", "musl-tools")?;
    program("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64")?;
    program("wixl", "wixl")?;
    program("msiinfo", "msitools")?;
    if first_line(&mut on.cargo(["cyclonedx", "--version"])).is_none() {
        install(&mut on.cargo(["install", "cargo-cyclonedx", "--locked"]))?;
    }
    let mut make = Command::new(on.root.join("packaging/dist"));
    make.env("IHD_IMAGE", image)
        .env("CARGO_TARGET_DIR", &on.target);
    run(make.arg(on.target.join("dist")))
}

/// Makes target/book/html of the documents.
pub fn book(on: &Workspace) -> anyhow::Result<()> {
    if first_line(Command::new("mdbook").arg("--version")).is_none() {
        install(&mut on.cargo(["install", "mdbook", "--locked"]))?;
    }
    run(Command::new(on.root.join("packaging/book")).arg(on.target.join("book")))
}

/// Runs a script that installs a release, uses the program and removes it, with the Debian package `tool`.
pub fn try_out(on: &Workspace, tool: &str, script: &str) -> anyhow::Result<()> {
    program(tool, tool)?;
    let mut script = Command::new(on.root.join(script));
    let [release, folder] = ["dist", "tried"].map(|name| on.target.join(name));
    run(script.arg(release).arg(folder))
}
