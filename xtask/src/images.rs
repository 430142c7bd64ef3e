//! The firmware's images, and the build of each.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

use crate::seal;
use crate::toolchain::{self, TARGET};
use crate::workspace::{Workspace, first_line, run};

/// Image of the firmware.
#[derive(Clone, Copy)]
pub struct ImageSpec {
    /// Name of its file.
    pub name: &'static str,
    features: &'static str,
}

/// Image for the controller board.
pub const STM32G474: ImageSpec = ImageSpec::new("stm32g474", "stm32g474");
/// Image that counts instructions in QEMU, and ends.
pub const COUNTS: ImageSpec = ImageSpec::new("instruction-counts", "instruction-counts");

/// Flashes a sealed copy of an image and shows its log, by probe-rs's own command.
pub fn run_on_board(on: &Workspace, image: &Path) -> anyhow::Result<()> {
    let images = on.target.join("firmware/images");
    let sealed = images.join("run.elf");
    fs::create_dir_all(&images).with_context(|| images.display().to_string())?;
    fs::copy(image, &sealed).with_context(|| image.display().to_string())?;
    seal::seal(&sealed)?;
    let mut probe_rs = Command::new("probe-rs");
    ensure!(
        first_line(probe_rs.arg("--version")).is_some(),
        "probe-rs is not installed: `cargo install probe-rs-tools --locked`; or without it `ihd flash --image {}`",
        sealed.display()
    );
    probe_rs_run(&sealed)
}

/// `probe-rs run`: flashes an ELF file and shows its log, or runs the tests that it holds.
pub fn probe_rs_run(elf: &Path) -> anyhow::Result<()> {
    let mut probe_rs = Command::new("probe-rs");
    run(probe_rs.args(["run", "--chip", "STM32G474RETx"]).arg(elf))
}

impl ImageSpec {
    const fn new(name: &'static str, features: &'static str) -> Self {
        Self { name, features }
    }

    /// Returns `cargo <subcommand>` on the packages of this image.
    fn cargo(self, subcommand: &str, on: &Workspace) -> Command {
        let mut command = toolchain::cargo(on, subcommand);
        command.args(["--package", "ihd-firmware", "--bin", "ihd-firmware"]);
        command.args(["--features", self.features]);
        command
    }

    /// Runs Clippy on the code that only this image compiles.
    pub fn lint(self, on: &Workspace) -> anyhow::Result<()> {
        let mut clippy = self.cargo("clippy", on);
        // Same profile as the build: macros and build scripts are then compiled once.
        run(clippy.args(["--profile", "firmware", "--", "-D", "warnings"]))
    }

    /// Builds the image; returns the path of the sealed ELF file for flashing. Cargo's own output has no CRC.
    pub fn build(self, on: &Workspace) -> anyhow::Result<PathBuf> {
        let mut build = self.cargo("build", on);
        run(build.args(["--profile", "firmware"]))?;
        // Cargo gives each image the same name.
        let target = on.target.join("firmware");
        let built = target.join(TARGET).join("firmware/ihd-firmware");
        let image = target.join("images").join(self.name);
        let image = image.with_extension("elf");
        fs::create_dir_all(target.join("images"))?;
        fs::copy(&built, &image).with_context(|| format!("could not copy {}", built.display()))?;
        seal::seal(&image)?;
        Ok(image)
    }
}
