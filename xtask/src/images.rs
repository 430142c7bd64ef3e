//! The firmware's images: which there are, and how each is built.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, bail};

use crate::toolchain::{FirmwareToolchain, TARGET};
use crate::workspace::{Workspace, spelled};

/// An image of the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// For the controller board.
    Stm32g474,
    /// The controller on QEMU's mps2-an386.
    Mps2An386,
    /// Counts instructions on the same machine, and ends.
    InstructionCounts,
}

impl Image {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Stm32g474, Self::Mps2An386, Self::InstructionCounts];

    /// Name of its file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stm32g474 => "stm32g474",
            Self::Mps2An386 => "mps2-an386",
            Self::InstructionCounts => "instruction-counts",
        }
    }

    fn features(self) -> &'static str {
        match self {
            Self::Stm32g474 => "stm32g474",
            Self::Mps2An386 => "mps2-an386",
            Self::InstructionCounts => "mps2-an386,instruction-counts",
        }
    }

    /// Clippy on what only this image compiles.
    pub fn lint(self, workspace: &Workspace, toolchain: &FirmwareToolchain) -> Command {
        let mut clippy = toolchain.cargo(workspace, "clippy");
        clippy
            .args(["--package", "ihd-firmware", "--bin", "ihd-firmware"])
            .args(["--features", self.features(), "--", "-D", "warnings"]);
        clippy
    }

    /// Builds it; returns where the ELF file is.
    pub fn build(
        self,
        workspace: &Workspace,
        toolchain: &FirmwareToolchain,
    ) -> anyhow::Result<PathBuf> {
        let mut build = toolchain.cargo(workspace, "build");
        build
            .args(["--package", "ihd-firmware", "--bin", "ihd-firmware"])
            .args(["--profile", "firmware", "--features", self.features()]);
        println!("$ {}", spelled(&build));
        let status = build.status().context("could not start cargo")?;
        if !status.success() {
            bail!("`{}` failed ({status}); see above", spelled(&build));
        }
        // Each image has the same name where cargo puts it.
        let target = workspace.target_dir().join("firmware");
        let built = target.join(TARGET).join("firmware/ihd-firmware");
        let images = target.join("images");
        fs::create_dir_all(&images)?;
        let kept = images.join(format!("{}.elf", self.name()));
        fs::copy(&built, &kept).with_context(|| format!("could not copy {}", built.display()))?;
        Ok(kept)
    }
}
