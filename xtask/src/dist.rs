//! `cargo xtask dist`: a release of this checkout, made by packaging/dist; `cargo xtask docs`: the documents as a book.

use std::path::Path;
use std::process::Command;

use crate::pypi;
use crate::setup::{install, program};
use crate::workspace::{Workspace, first_line, run};

/// Makes target/dist with the firmware's `image` in the program.
pub fn make(on: &Workspace, image: &Path) -> anyhow::Result<()> {
    let targets = "target add x86_64-unknown-linux-musl aarch64-unknown-linux-musl aarch64-unknown-linux-gnu x86_64-pc-windows-gnu";
    install(Command::new("rustup").args(targets.split(' ')))?;
    let from_pypi = pypi::tools(on, "release")?;
    program("musl-gcc", "musl-tools")?;
    program("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64")?;
    program("wixl", "wixl")?;
    program("msiinfo", "msitools")?;
    if first_line(&mut on.cargo(["cyclonedx", "--version"])).is_none() {
        install(&mut on.cargo(["install", "cargo-cyclonedx", "--locked"]))?;
    }
    let mut make = Command::new(on.root.join("packaging/dist"));
    make.env("IHD_IMAGE", image)
        .env("CARGO_TARGET_DIR", &on.target)
        .env("PYTHONPATH", from_pypi);
    run(make.arg(on.target.join("dist")))
}

/// Makes target/book/html of the documents.
pub fn book(on: &Workspace) -> anyhow::Result<()> {
    if first_line(Command::new("mdbook").arg("--version")).is_none() {
        install(&mut on.cargo(["install", "mdbook", "--locked"]))?;
    }
    run(Command::new(on.root.join("packaging/book")).arg(on.target.join("book")))
}

/// Runs a script that uses a release as one who has no cargo does; `tools`: programs that it needs, and their Debian packages.
pub fn try_out(on: &Workspace, tools: &[[&str; 2]], script: &str) -> anyhow::Result<()> {
    let find = |[tool, package]: &[&str; 2]| program(tool, package).map(drop);
    tools.iter().try_for_each(find)?;
    let mut script = Command::new(on.root.join(script));
    let [release, folder] = ["dist", "tried"].map(|name| on.target.join(name));
    run(script.arg(release).arg(folder))
}
