//! The compiler that builds the firmware: rustup's where it has the board's target, else Debian's.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail, ensure};

use crate::workspace::{Workspace, first_line};

/// What the controller board runs.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// Where Debian's rustc-web puts its compiler.
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
/// Where cargo's build-std looks under a compiler's root.
const LIBRARY_SOURCE: &str = "lib/rustlib/src/rust/library";
/// The oldest compiler that the workspace builds with.
const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// A compiler that can build for [`TARGET`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FirmwareToolchain {
    /// The active toolchain has the target's libraries.
    Rustup,
    /// Debian's rustc-web, which builds the target's libraries from rust-web-src.
    DebianWeb { linker: PathBuf },
}

impl FirmwareToolchain {
    /// The active toolchain, if it has the target's libraries.
    pub fn rustup() -> anyhow::Result<Self> {
        let mut rustc = Command::new("rustc");
        let folder = first_line(rustc.args(["--print", "target-libdir", "--target", TARGET]));
        // The folder is named even when it is missing.
        if folder.is_some_and(|folder| Path::new(&folder).is_dir()) {
            return Ok(Self::Rustup);
        }
        bail!("the active toolchain has no {TARGET}");
    }

    /// Debian's compiler, if it can; else what it lacks.
    pub fn debian_web() -> anyhow::Result<Self> {
        let printed = first_line(Command::new(DEBIAN_RUSTC).arg("-V"));
        let printed = printed.with_context(|| format!("there is no {DEBIAN_RUSTC}"))?;
        let version = printed.split_whitespace().nth(1).unwrap_or_default();
        let sysroot = first_line(Command::new(DEBIAN_RUSTC).args(["--print", "sysroot"]));
        // Its Cargo.lock pins what the library itself depends on.
        let library = Path::new(&sysroot.unwrap_or_default()).join(LIBRARY_SOURCE);
        let has_source = library.join("Cargo.lock").is_file() && library.join("core").is_dir();
        Self::of_debian(version, has_source, find_linker())
    }

    fn of_debian(version: &str, source: bool, linker: Option<PathBuf>) -> anyhow::Result<Self> {
        ensure!(
            version_parts(version) >= version_parts(OLDEST),
            "{DEBIAN_RUSTC} is {version}, older than the {OLDEST} that this workspace needs"
        );
        ensure!(source, "{DEBIAN_RUSTC} has no {LIBRARY_SOURCE}");
        let lacks = "there is no rust-lld in the active toolchain and no lld on the PATH";
        linker
            .map(|linker| Self::DebianWeb { linker })
            .context(lacks)
    }

    /// `cargo <subcommand>` set up for the board; the caller adds packages and what else it wants.
    pub fn cargo(&self, workspace: &Workspace, subcommand: &str) -> Command {
        let mut command = workspace.cargo([subcommand, "--target", TARGET]);
        command.arg("--target-dir");
        command.arg(workspace.target.join("firmware"));
        // Either would silently replace the linker arguments of .cargo/config.toml.
        command.env_remove("RUSTFLAGS");
        command.env_remove("CARGO_ENCODED_RUSTFLAGS");
        // Without it defmt keeps errors alone, whatever docs/board.md says of the log's lines.
        command.env("DEFMT_LOG", "info");
        if let Self::DebianWeb { linker } = self {
            command.args(["-Z", "build-std=core,alloc"]);
            // BOOTSTRAP: -Z on a stable compiler. The linker: Debian's compiler comes without rust-lld.
            command.env("RUSTC", DEBIAN_RUSTC);
            command.env("RUSTC_BOOTSTRAP", "1");
            command.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker);
            // `cargo run` points it at rustup's libraries, which are another compiler's.
            command.env_remove("LD_LIBRARY_PATH");
        }
        command
    }

    /// What it is, for people.
    pub fn describe(&self) -> String {
        match self {
            Self::Rustup => format!("the active toolchain, which has {TARGET}"),
            Self::DebianWeb { linker } => format!("Debian's {DEBIAN_RUSTC}, linked by {linker:?}"),
        }
    }
}

/// rustup's rust-lld, or another lld on the PATH.
fn find_linker() -> Option<PathBuf> {
    let sysroot = first_line(Command::new("rustc").args(["--print", "sysroot"]))?;
    let libraries = Path::new(&sysroot).join("lib/rustlib");
    let of_hosts = libraries.read_dir().into_iter().flatten().flatten();
    let of_hosts = of_hosts.map(|host| host.path().join("bin/rust-lld"));
    let path = env::var_os("PATH").unwrap_or_default();
    let on_path = env::split_paths(&path);
    let on_path = on_path.flat_map(|dir| [dir.join("rust-lld"), dir.join("ld.lld")]);
    of_hosts.chain(on_path).find(|linker| linker.is_file())
}

/// `1.96.0-nightly` as numbers that compare: `[1, 96, 0]`.
fn version_parts(version: &str) -> Vec<u32> {
    let numbers = version.split(['.', '-']);
    numbers.map_while(|part| part.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn debian(version: &str, source: bool, linker: Option<&str>) -> Result<(), String> {
        let found = FirmwareToolchain::of_debian(version, source, linker.map(PathBuf::from));
        found.map(drop).map_err(|why| why.to_string())
    }

    #[test]
    fn debian_needs_a_new_compiler_its_source_and_a_linker() {
        assert_eq!(debian("1.100.0-nightly", true, Some("/lld")), Ok(()));
        let old = debian("1.63.0", true, Some("/lld"));
        assert!(old.unwrap_err().contains("older than"));
        let bare = debian("1.96.0", false, Some("/lld"));
        assert!(bare.unwrap_err().contains("library"));
        assert!(debian("1.96.0", true, None).unwrap_err().contains("lld"));
    }

    #[test]
    fn debian_builds_the_library_too() {
        let workspace = Workspace::find().unwrap();
        let linker = PathBuf::from("/lld");
        let command = FirmwareToolchain::DebianWeb { linker }.cargo(&workspace, "build");
        let mut words = command.get_args();
        assert!(words.any(|word| word == "build-std=core,alloc"));
        let mut variables = command.get_envs();
        assert!(variables.any(|set| set == ("RUSTC".as_ref(), Some(DEBIAN_RUSTC.as_ref()))));
        let plain = FirmwareToolchain::Rustup.cargo(&workspace, "build");
        assert!(plain.get_args().all(|word| word != "-Z"));
    }
}
