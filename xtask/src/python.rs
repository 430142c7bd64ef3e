//! The Python package: its wheel, made of what the tests compile, is installed and tested.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::bail;

use crate::pypi::{self, pip, python};
use crate::workspace::{Workspace, run};

/// Folder of the package in the checkout.
const FOLDER: &str = "python";

/// The program, with which the package's results are compared, and all libraries. An example lets cargo choose features as it does for
/// the tests, so that nothing is compiled again.
const BUILT: &str = "--lib --bin ihd --example pages";

/// Builds the wheel, installs it and runs its tests; `full` builds it as `pip install ./python` does.
pub fn test(on: &Workspace, full: bool) -> anyhow::Result<()> {
    let tools = pypi::tools(on, "python")?;
    run(&mut on.whole("build", BUILT))?;
    let wheel = wheel(on, &tools, full)?;
    let site = on.target.join("python/site");
    if site.exists() {
        fs::remove_dir_all(&site)?;
    }
    run(pip(&site).arg("--no-deps").arg(&wheel))?;
    let mut tests = python();
    tests.current_dir(on.root.join(FOLDER).join("tests"));
    // Not from the checkout: the installed package.
    let path = std::env::join_paths([&site, &tools])?;
    tests
        .env("PYTHONPATH", path)
        .env("IHD_PROGRAM", on.target.join("debug/ihd"))
        // The checkout stays as it is.
        .env("PYTHONDONTWRITEBYTECODE", "1");
    tests.args(["-W", "error", "-m", "unittest", "discover", "--verbose"]);
    run(&mut tests)
}

/// Builds the wheel and returns its path.
fn wheel(on: &Workspace, tools: &Path, full: bool) -> anyhow::Result<PathBuf> {
    let out = on.target.join("python/wheel");
    if out.exists() {
        fs::remove_dir_all(&out)?;
    }
    let mut build = Command::new(tools.join("bin/maturin"));
    let mut path = vec![tools.join("bin")];
    if full {
        build = python();
        let words = "-m pip wheel --no-deps --no-build-isolation . --wheel-dir";
        build.args(words.split(' ')).env("PYTHONPATH", tools);
    } else {
        let cargo = on.root.join("xtask/maturin");
        of_whole_workspace(on, build.env("CARGO", cargo.join("cargo")));
        build.args("build --profile dev --compatibility linux --out".split(' '));
        path.insert(0, cargo);
    }
    let rest = std::env::var_os("PATH").unwrap_or_default();
    path.extend(std::env::split_paths(&rest));
    build.arg(&out);
    build.current_dir(on.root.join(FOLDER));
    run(build.env("PATH", std::env::join_paths(path)?))?;
    let files = fs::read_dir(&out)?.flatten().map(|file| file.path());
    let is_wheel = |path: &PathBuf| path.extension().is_some_and(|end| end == "whl");
    let wheels: Vec<_> = files.filter(is_wheel).collect();
    let [wheel] = &wheels[..] else {
        bail!("{} holds {} wheels, not one", out.display(), wheels.len());
    };
    Ok(wheel.clone())
}

/// Gives `maturin` the environment of every build here, and the commands that xtask/maturin/cargo runs.
fn of_whole_workspace(on: &Workspace, maturin: &mut Command) {
    let rest = format!("{BUILT} --message-format json-render-diagnostics");
    let whole = on.whole("build", &rest);
    for (name, value) in whole.get_envs() {
        match value {
            Some(value) => maturin.env(name, value),
            None => maturin.env_remove(name),
        };
    }
    let words = std::iter::once(whole.get_program()).chain(whole.get_args());
    let quoted: String = words.map(|word| format!("'{}' ", word.display())).collect();
    maturin.env("IHD_WHOLE", quoted);
    maturin.env("IHD_CARGO", whole.get_program());
}
