//! Small Linux that the emulated board is connected to, made of the distribution's packages by tests/stm32g474/guest/make.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::setup::{install, say};
use crate::workspace::{Workspace, run};
use crate::{board, emulator};

/// Runs the tests with a Linux guest; `image` is the board's, `full` adds the tests of the full tier.
pub fn test(workspace: &Workspace, image: &Path, full: bool) -> anyhow::Result<()> {
    let qemu = emulator::find(workspace, emulator::X86)?;
    let guest = find(workspace)?;
    let mut test = board::run_tests(workspace, &["usb_linux"], full)?;
    // Other steps run beside it.
    test.env("NEXTEST_TEST_THREADS", "1");
    test.env("IHD_QEMU_X86", qemu).env("IHD_GUEST", guest);
    test.env("IHD_STM32G474_IMAGE", image)
        .env("IHD_PROGRAM", workspace.program("ihd")?);
    run(&mut test)
}

/// Returns a folder with `vmlinux`, `busybox` and `modules`, creating it if necessary.
pub fn find(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let folder = workspace.target.join("tools/guest");
    if !folder.is_dir() {
        let make = workspace.root.join("tests/stm32g474/guest/make");
        install(Command::new(make).arg(&folder)).context("cannot make the guest")?;
    }
    say(&format!("guest: {}", folder.display()));
    Ok(folder)
}
