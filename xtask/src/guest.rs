//! A small Linux to which the emulated board is plugged: a kernel and busybox from the distribution's packages,
//! unpacked beside the build, where they disturb nothing.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail, ensure};

use crate::setup::{install, say};
use crate::workspace::{Workspace, first_line, run};
use crate::{board, emulator};

/// Metapackages of the kernel: Debian's, Ubuntu's.
const KERNELS: [&str; 2] = ["linux-image-amd64", "linux-image-generic"];
/// What of a kernel's packages is unpacked.
const UNPACKED: [&str; 6] = [
    "*/vmlinuz-*",
    "*/kernel/drivers/virtio/*",
    "*/kernel/drivers/net/*virtio_net.ko*",
    "*/kernel/drivers/net/*failover.ko*",
    "*/kernel/net/core/*",
    "*/kernel/drivers/usb/*",
];
/// The modules that are wanted; others are, because these depend on them.
const MODULES: [&str; 3] = ["virtio_pci", "virtio_net", "vhci-hcd"];

/// Compressions by their magic numbers, with the program that knows them.
const COMPRESSIONS: [(&[u8], &str); 2] = [(b"\xFD7zXZ\0", "xz"), (b"\x28\xB5\x2F\xFD", "zstd")];

/// Runs the tests with a Linux guest; `image` is the board's.
pub fn test(workspace: &Workspace, image: &Path) -> anyhow::Result<()> {
    let qemu = emulator::find(workspace, emulator::X86)?;
    let guest = find(workspace)?;
    board::tools(workspace)?;
    // What the tests of the workspace built; built again only where they did not run.
    let built = "test --workspace --lib --bins --tests --no-run";
    run(&mut workspace.cargo(built.split(' ')))?;
    let mut test = board::cargo(workspace, "test");
    test.args(["--test", "usb_linux", "--", "--ignored", "--nocapture"]);
    // One after the other: each keeps two cores busy, the guest's and the chip's.
    test.args(["--test-threads", "1"]);
    test.env("IHD_QEMU_X86", qemu).env("IHD_GUEST", guest);
    test.env("IHD_STM32G474_IMAGE", image)
        .env("IHD_PROGRAM", workspace.target.join("debug/ihd"));
    run(&mut test)
}

/// A folder with `vmlinux`, `busybox` and `modules`, which is made if need be.
pub fn find(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let folder = workspace.target.join("tools/guest");
    let complete = folder.join("complete");
    if !complete.exists() {
        let arch = first_line(Command::new("dpkg").arg("--print-architecture"));
        ensure!(
            arch.as_deref() == Some("amd64"),
            "the guest is made of the packages of Debian or Ubuntu for amd64, which this machine does not use"
        );
        make(&folder).context("cannot make the guest")?;
        fs::write(&complete, "")?;
    }
    say(&format!("guest: {}", folder.display()));
    Ok(folder)
}

fn make(folder: &Path) -> anyhow::Result<()> {
    let (archives, root) = (folder.join("archives"), folder.join("root"));
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(&archives)?;
    fs::create_dir_all(&root)?;
    for package in packages()?
        .iter()
        .map(String::as_str)
        .chain(["busybox-static"])
    {
        install(
            Command::new("apt-get")
                .arg("download")
                .arg(package)
                .current_dir(&archives),
        )?;
    }
    for entry in fs::read_dir(&archives)? {
        let archive = entry?.path();
        let patterns: &[&str] = if archive.to_string_lossy().contains("busybox") {
            &["*bin/busybox"]
        } else {
            &UNPACKED
        };
        unpack(&archive, &root, patterns)?;
    }
    let files = files(&root)?;
    let named = |start: &str| {
        let found = files.iter().find(|file| name(file).starts_with(start));
        found.with_context(|| format!("the packages hold no {start}"))
    };
    fs::copy(named("busybox")?, folder.join("busybox"))?;
    let kernel = fs::read(named("vmlinuz-")?)?;
    // A kernel that has unpacked itself already boots three seconds sooner.
    let plain = unpacked_kernel(&kernel).unwrap_or(kernel);
    fs::write(folder.join("vmlinux"), plain)?;
    modules(&files, &folder.join("modules"))?;
    fs::remove_dir_all(&archives)?;
    fs::remove_dir_all(&root).map_err(Into::into)
}

/// The kernel's image and modules: what the metapackage depends on, directly or not.
fn packages() -> anyhow::Result<BTreeSet<String>> {
    let needed = |metapackage: &str| -> BTreeSet<String> {
        let mut apt = Command::new("apt-cache");
        apt.args(["depends", "--recurse", "--no-recommends", "--no-suggests"]);
        apt.args([
            "--no-conflicts",
            "--no-breaks",
            "--no-replaces",
            "--no-enhances",
        ]);
        let listed = apt.arg(metapackage).output().map(|output| output.stdout);
        let listed = String::from_utf8(listed.unwrap_or_default()).unwrap_or_default();
        let starts =
            |name: &&str| name.starts_with("linux-image-") || name.starts_with("linux-modules-");
        let real = |name: &&str| !KERNELS.contains(name) && !name.ends_with("-unsigned");
        listed
            .lines()
            .filter(starts)
            .filter(real)
            .map(str::to_owned)
            .collect()
    };
    let find = || {
        KERNELS
            .iter()
            .map(|name| needed(name))
            .find(|packages| !packages.is_empty())
    };
    if let Some(packages) = find() {
        return Ok(packages);
    }
    // A fresh container knows no packages at all.
    install(Command::new("apt-get").arg("update"))?;
    find().with_context(|| format!("apt knows neither of {KERNELS:?}"))
}

/// Unpacks the files that match, of a package that may have none of them.
fn unpack(archive: &Path, root: &Path, patterns: &[&str]) -> anyhow::Result<()> {
    let mut package = Command::new("dpkg-deb")
        .arg("--fsys-tarfile")
        .arg(archive)
        .stdout(Stdio::piped())
        .spawn()?;
    let content = package.stdout.take().context("dpkg-deb prints nothing")?;
    let mut tar = Command::new("tar");
    tar.arg("-x")
        .arg("-C")
        .arg(root)
        .arg("--wildcards")
        .args(patterns);
    // Its complaints are about patterns that match nothing.
    tar.stdin(content).stderr(Stdio::null()).status()?;
    ensure!(
        package.wait()?.success(),
        "dpkg-deb cannot read {}",
        archive.display()
    );
    Ok(())
}

fn files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            found.extend(files(&entry.path())?);
        } else {
            found.push(entry.path());
        }
    }
    Ok(found)
}

fn name(file: &Path) -> &str {
    file.file_name()
        .and_then(|name| name.to_str())
        .unwrap_or_default()
}

/// The kernel in a bzImage, where it is compressed in a way that is known here.
fn unpacked_kernel(image: &[u8]) -> Option<Vec<u8>> {
    COMPRESSIONS.iter().find_map(|(magic, program)| {
        let start = image
            .windows(magic.len())
            .position(|bytes| bytes == *magic)?;
        let kernel = decompressed(program, &image[start..])?;
        kernel.starts_with(b"\x7FELF").then_some(kernel)
    })
}

/// What the program makes of the bytes; what follows them makes it complain, and does not matter.
fn decompressed(program: &str, bytes: &[u8]) -> Option<Vec<u8>> {
    let mut command = Command::new(program);
    command
        .args(["-d", "-c"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut child = command.spawn().ok()?;
    let mut input = child.stdin.take()?;
    std::thread::scope(|scope| {
        scope.spawn(move || drop(input.write_all(bytes)));
        child.wait_with_output().ok().map(|output| output.stdout)
    })
}

/// The wanted modules and those before them, numbered in the order in which they are to be loaded.
fn modules(files: &[PathBuf], folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder)?;
    let mut order = Vec::new();
    for module in MODULES {
        load(module, files, &mut order)?;
    }
    for (number, (module, code)) in order.iter().enumerate() {
        fs::write(folder.join(format!("{number:02}-{module}.ko")), code)?;
    }
    Ok(())
}

/// A module, after those that it depends on.
fn load(module: &str, files: &[PathBuf], order: &mut Vec<(String, Vec<u8>)>) -> anyhow::Result<()> {
    let spelled = |text: &str| text.replace('-', "_");
    if order
        .iter()
        .any(|(known, _)| spelled(known) == spelled(module))
    {
        return Ok(());
    }
    let is_it = |file: &&PathBuf| {
        name(file)
            .split_once(".ko")
            .is_some_and(|(stem, _)| spelled(stem) == spelled(module))
    };
    let Some(file) = files.iter().find(is_it) else {
        // Built into the kernel where it is no module.
        say(&format!("guest: no module {module}; in the kernel itself?"));
        return Ok(());
    };
    let code = fs::read(file)?;
    let packed = COMPRESSIONS
        .iter()
        .find(|(magic, _)| code.starts_with(magic));
    let code = match packed {
        Some((_, program)) => {
            decompressed(program, &code).with_context(|| format!("cannot run {program}"))?
        }
        None => code,
    };
    for dependency in dependencies(&code)?
        .split(',')
        .filter(|name| !name.is_empty())
    {
        load(dependency, files, order)?;
    }
    order.push((module.to_owned(), code));
    Ok(())
}

/// "depends" of a module's information: other modules, with commas between them.
fn dependencies(code: &[u8]) -> anyhow::Result<String> {
    let key = b"\0depends=";
    let Some(start) = code.windows(key.len()).position(|bytes| bytes == key) else {
        bail!("a module does not say what it depends on");
    };
    let rest = &code[start + key.len()..];
    let end = rest
        .iter()
        .position(|byte| *byte == 0)
        .unwrap_or(rest.len());
    Ok(String::from_utf8_lossy(&rest[..end]).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_says_what_it_depends_on() {
        let code = b"\x7FELF...\0license=GPL\0depends=usbcore,usbip-core\0retpoline=Y\0";
        assert_eq!(dependencies(code).unwrap(), "usbcore,usbip-core");
        assert!(dependencies(b"no module").is_err());
    }
}
