//! `cargo xtask dist`: a release of this checkout for Linux, made by packaging/dist; `cargo xtask docs`: the documents as a book.

use std::path::Path;
use std::process::Command;

use crate::setup::{install, program};
use crate::workspace::{Workspace, first_line, run};

/// Makes target/dist with the firmware's `image` in the program.
pub fn make(on: &Workspace, image: &Path) -> anyhow::Result<()> {
    let target = format!("{}-unknown-linux-musl", std::env::consts::ARCH);
    install(Command::new("rustup").args(["target", "add", &target]))?;
    program("musl-gcc", "musl-tools")?;
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

/// Installs the package in a new Debian, uses the program, and removes both: as root, with debootstrap.
pub fn try_package(on: &Workspace) -> anyhow::Result<()> {
    program("debootstrap", "debootstrap")?;
    let mut script = Command::new(on.root.join("packaging/try-deb"));
    run(script
        .arg(on.target.join("dist"))
        .arg(on.target.join("debian")))
}
