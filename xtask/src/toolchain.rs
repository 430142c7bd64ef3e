//! The compiler that builds the firmware: rustup's where it has the board's target, else Debian's.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::workspace::Workspace;

/// What the controller board runs.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// Where Debian's rustc-web puts its compiler.
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
/// The oldest compiler that the workspace builds with.
const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// A compiler that can build for [`TARGET`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FirmwareToolchain {
    /// The active toolchain has the target's libraries.
    Rustup,
    /// Debian's rustc-web, which builds the target's libraries from rust-web-src.
    DebianWeb { rustc: PathBuf, linker: PathBuf },
}

impl FirmwareToolchain {
    /// `cargo <subcommand>` set up for the board; the caller adds packages and what else it wants.
    pub fn cargo(&self, workspace: &Workspace, subcommand: &str) -> Command {
        let mut command = workspace.cargo([subcommand, "--target", TARGET]);
        command
            .arg("--target-dir")
            .arg(workspace.target_dir().join("firmware"));
        // Either would silently replace the linker arguments of .cargo/config.toml.
        command
            .env_remove("RUSTFLAGS")
            .env_remove("CARGO_ENCODED_RUSTFLAGS");
        if let Self::DebianWeb { rustc, linker } = self {
            command.args(["-Z", "build-std=core,alloc"]);
            // BOOTSTRAP: -Z on a stable compiler. The linker: Debian's compiler comes without rust-lld.
            command.env("RUSTC", rustc).env("RUSTC_BOOTSTRAP", "1");
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
            Self::DebianWeb { rustc, linker } => format!(
                "Debian's compiler {} with its library source, linked by {}",
                rustc.display(),
                linker.display()
            ),
        }
    }
}

/// What is on this machine that could build the firmware.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The active toolchain has the target's libraries.
    pub target_installed: bool,
    /// Debian's compiler, if there is one.
    pub debian: Option<DebianRust>,
    /// rustup's rust-lld, or another lld on the PATH.
    pub linker: Option<PathBuf>,
}

/// Debian's compiler as found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DebianRust {
    pub rustc: PathBuf,
    /// `1.96.0`
    pub version: String,
    pub has_library_source: bool,
}

impl Found {
    /// Looks at the active toolchain and at Debian's.
    pub fn on_this_machine() -> Self {
        Self {
            target_installed: target_installed(),
            debian: DebianRust::find(),
            linker: find_linker(),
        }
    }

    /// The active toolchain, if it can.
    pub fn rustup(&self) -> Result<FirmwareToolchain, String> {
        if self.target_installed {
            Ok(FirmwareToolchain::Rustup)
        } else {
            Err(format!("the active toolchain has no {TARGET}"))
        }
    }

    /// Debian's compiler, if it can; else what it lacks.
    pub fn debian_web(&self) -> Result<FirmwareToolchain, String> {
        let Some(debian) = &self.debian else {
            return Err(format!("there is no {DEBIAN_RUSTC}"));
        };
        let rustc = debian.rustc.display();
        if version_parts(&debian.version) < version_parts(OLDEST) {
            return Err(format!(
                "{rustc} is {}, older than the {OLDEST} that this workspace needs",
                debian.version
            ));
        }
        if !debian.has_library_source {
            return Err(format!(
                "{rustc} has no library source (lib/rustlib/src/rust/library)"
            ));
        }
        let Some(linker) = &self.linker else {
            return Err(
                "there is no rust-lld in the active toolchain and no lld on the PATH".into(),
            );
        };
        Ok(FirmwareToolchain::DebianWeb {
            rustc: debian.rustc.clone(),
            linker: linker.clone(),
        })
    }
}

impl DebianRust {
    fn find() -> Option<Self> {
        let rustc = PathBuf::from(DEBIAN_RUSTC);
        let printed = first_line(Command::new(&rustc).arg("-V"))?;
        let sysroot = first_line(Command::new(&rustc).args(["--print", "sysroot"]))?;
        // Where cargo's build-std looks; its Cargo.lock pins what the library itself depends on.
        let library = Path::new(&sysroot).join("lib/rustlib/src/rust/library");
        Some(Self {
            rustc,
            version: printed.split_whitespace().nth(1)?.to_owned(),
            has_library_source: library.join("Cargo.lock").is_file()
                && library.join("core").is_dir(),
        })
    }
}

fn target_installed() -> bool {
    let printed =
        first_line(Command::new("rustc").args(["--print", "target-libdir", "--target", TARGET]));
    // The folder is named even when it is missing.
    printed.is_some_and(|folder| Path::new(&folder).is_dir())
}

fn find_linker() -> Option<PathBuf> {
    let sysroot = first_line(Command::new("rustc").args(["--print", "sysroot"]))?;
    let libraries = Path::new(&sysroot).join("lib/rustlib");
    let of_hosts = libraries.read_dir().into_iter().flatten().flatten();
    of_hosts
        .map(|host| host.path().join("bin/rust-lld"))
        .chain(on_path("rust-lld"))
        .chain(on_path("ld.lld"))
        .find(|linker| linker.is_file())
}

/// Where `program` could be, by the PATH.
pub fn on_path(program: &str) -> Vec<PathBuf> {
    let folders = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&folders)
        .map(|folder| folder.join(program))
        .collect()
}

/// The first line that a command prints, if it succeeds.
pub fn first_line(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let line = text.lines().next()?.trim();
    (output.status.success() && !line.is_empty()).then(|| line.to_owned())
}

/// `1.96.0-nightly` as numbers that compare: `[1, 96, 0]`.
fn version_parts(version: &str) -> Vec<u32> {
    let numbers = version.split(['.', '-']);
    numbers.map_while(|part| part.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn debian(version: &str, has_library_source: bool) -> Found {
        Found {
            target_installed: false,
            debian: Some(DebianRust {
                rustc: DEBIAN_RUSTC.into(),
                version: version.into(),
                has_library_source,
            }),
            linker: Some("/lld".into()),
        }
    }

    #[test]
    fn the_active_toolchain_needs_only_the_target() {
        let found = Found {
            target_installed: true,
            ..Found::default()
        };
        assert_eq!(found.rustup(), Ok(FirmwareToolchain::Rustup));
        assert!(Found::default().rustup().is_err());
    }

    #[test]
    fn debian_needs_a_new_compiler_its_source_and_a_linker() {
        let whole = debian("1.96.0", true);
        assert!(whole.debian_web().is_ok());
        let why = |found: Found| found.debian_web().unwrap_err();
        assert!(why(debian("1.63.0", true)).contains("older than"));
        assert!(why(debian("1.96.0", false)).contains("no library source"));
        let linker = None;
        assert!(why(Found { linker, ..whole }).contains("lld"));
        assert!(why(Found::default()).contains(DEBIAN_RUSTC));
    }

    #[test]
    fn versions_compare_by_number() {
        assert!(version_parts("1.100.0") > version_parts("1.95"));
        assert!(version_parts("1.95.0-nightly") >= version_parts("1.95"));
    }

    #[test]
    fn debian_builds_the_library_too() {
        let workspace = Workspace::find().unwrap();
        let toolchain = debian("1.96.0", true).debian_web().unwrap();
        let command = toolchain.cargo(&workspace, "build");
        let words: Vec<_> = command.get_args().collect();
        assert!(words.iter().any(|word| *word == "build-std=core,alloc"));
        let rustc = command.get_envs().find(|(name, _)| *name == "RUSTC");
        assert_eq!(rustc.unwrap().1, Some(DEBIAN_RUSTC.as_ref()));
        let plain = FirmwareToolchain::Rustup.cargo(&workspace, "build");
        assert!(plain.get_args().all(|word| word != "-Z"));
    }
}
