//! Linux guest under QEMU, controlled over its serial port.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use anyhow::{Context, bail, ensure};

use crate::initramfs::{Archive, scratch};

/// Longest time until its shell answers: three seconds on an idle machine.
const BOOT: Duration = Duration::from_secs(120);
const INIT: &[u8] = include_bytes!("../../guest/init");

/// Linux guest; it ends with this value.
pub struct Guest {
    qemu: Child,
    input: ChildStdin,
    lines: Receiver<String>,
}

/// Result of a command in the guest.
#[derive(Debug)]
pub struct Answer {
    /// Exit status.
    pub status: i32,
    /// Output, errors included.
    pub text: String,
}

impl Answer {
    /// Output of a command that must succeed.
    pub fn text(self) -> anyhow::Result<String> {
        ensure!(
            self.status == 0,
            "exit status {}: {}",
            self.status,
            self.text
        );
        Ok(self.text)
    }
}

fn variable(name: &str) -> anyhow::Result<PathBuf> {
    let path = env::var_os(name)
        .with_context(|| format!("{name} is not set: `cargo xtask test --only usb`"))?;
    Ok(path.into())
}

/// Archive with busybox, the kernel's modules, `ihd`, `vhci-attach`, `usb-descriptors` and the board's image.
fn initramfs(files: &Path) -> anyhow::Result<Vec<u8>> {
    let mut archive = Archive::default();
    archive.file("init", INIT);
    for folder in ["proc", "sys", "dev", "tmp"] {
        archive.mount_point(folder);
    }
    archive.file("bin/busybox", &fs::read(files.join("busybox"))?);
    for entry in fs::read_dir(files.join("modules"))? {
        let path = entry?.path();
        let name = path
            .file_name()
            .context("a module")?
            .to_string_lossy()
            .into_owned();
        archive.file(&format!("lib/modules/{name}"), &fs::read(&path)?);
    }
    let programs = [
        ("bin/ihd", variable("IHD_PROGRAM")?),
        ("bin/vhci-attach", env!("CARGO_BIN_EXE_vhci-attach").into()),
        (
            "bin/usb-descriptors",
            env!("CARGO_BIN_EXE_usb-descriptors").into(),
        ),
    ];
    archive.file("image.elf", &fs::read(variable("IHD_STM32G474_IMAGE")?)?);
    for (path, program) in programs {
        archive.program(path, &program)?;
    }
    Ok(archive.finish())
}

impl Guest {
    /// Boots a guest.
    pub fn boot() -> anyhow::Result<Self> {
        let files = variable("IHD_GUEST")?;
        let image = scratch();
        fs::write(&image, initramfs(&files)?)?;
        let mut command = Command::new(variable("IHD_QEMU_X86")?);
        command.args([
            "-M", "pc", "-accel", "tcg", "-cpu", "max", "-m", "512", "-smp", "1",
        ]);
        command.args([
            "-nodefaults",
            "-no-user-config",
            "-display",
            "none",
            "-no-reboot",
        ]);
        command.args(["-serial", "stdio", "-netdev", "user,id=net"]);
        command.args(["-device", "virtio-net-pci,netdev=net,romfile="]);
        // The time stamp counter of an emulated processor is not reliable under load.
        command.args([
            "-append",
            "console=ttyS0 quiet panic=-1 tsc=unstable clocksource=hpet",
        ]);
        command
            .arg("-kernel")
            .arg(files.join("vmlinux"))
            .arg("-initrd")
            .arg(&image);
        let mut qemu = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let input = qemu.stdin.take().context("QEMU's input")?;
        let output = qemu.stdout.take().context("QEMU's output")?;
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            let mut output = BufReader::new(output);
            let mut line = Vec::new();
            while output
                .read_until(b'\n', &mut line)
                .is_ok_and(|length| length > 0)
            {
                let text = String::from_utf8_lossy(&line).trim_end().to_owned();
                if sender.send(text).is_err() {
                    break;
                }
                line.clear();
            }
        });
        let mut guest = Self { qemu, input, lines };
        let booted = guest
            .until("@@ready", BOOT)
            .context("the guest does not boot");
        fs::remove_file(&image)?;
        booted?;
        Ok(guest)
    }

    /// Reads lines up to one that begins with `end`; returns them and the rest of that line.
    fn until(&mut self, end: &str, timeout: Duration) -> anyhow::Result<(String, String)> {
        let (deadline, mut text) = (Instant::now() + timeout, String::new());
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(left) else {
                bail!("no {end} within {timeout:?}; so far: {text}");
            };
            if let Some(rest) = line.strip_prefix(end) {
                return Ok((text, rest.trim().to_owned()));
            }
            text += &line;
            text.push('\n');
        }
    }

    /// Runs a line of shell.
    pub fn run(&mut self, line: &str, timeout: Duration) -> anyhow::Result<Answer> {
        writeln!(self.input, "{line}")?;
        let (text, status) = self
            .until("@@status", timeout)
            .with_context(|| line.to_owned())?;
        Ok(Answer {
            status: status.parse()?,
            text,
        })
    }

    /// Runs a line of shell that must succeed. The time limit only ends a hang: the guest's processor is emulated.
    pub fn shell(&mut self, line: &str) -> anyhow::Result<String> {
        let answer = self.run(line, Duration::from_secs(600))?;
        answer.text().with_context(|| line.to_owned())
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        drop(self.qemu.kill());
        drop(self.qemu.wait());
    }
}
