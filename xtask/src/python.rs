//! The Python package: its wheel, made of what the tests compile, is installed and tested.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use crate::setup::{install, say};
use crate::workspace::{Workspace, first_line, run};

/// Folder of the package in the checkout.
const FOLDER: &str = "python";

/// PyPI's packages: the wheel's builder, as in pyproject.toml, numpy, which the package needs, and matplotlib for the notebooks.
const PACKAGES: [&str; 4] = [
    "maturin==1.16.0",
    "matplotlib==3.10.8",
    "numpy==2.2.6; python_version < '3.14'",
    "numpy==2.5.5; python_version >= '3.14'",
];

/// Installs [`PACKAGES`] into a folder of their own beside the build, once, and returns it.
pub fn tools(on: &Workspace) -> anyhow::Result<PathBuf> {
    // Oldest as in the package's pyproject.toml.
    let version = r#"import sys; print("{}.{}".format(*sys.version_info)); sys.exit(sys.version_info < (3, 10))"#;
    let version = first_line(python().args(["-c", version]));
    let version = version.context("the package needs `python3` 3.10 or later on the PATH")?;
    let folder = on.target.join("tools/python");
    let mark = folder.join("installed");
    let wanted = format!("Python {version}: {}", PACKAGES.join(", "));
    if !fs::read_to_string(&mark).is_ok_and(|there| there == wanted) {
        let mut pip = pip(&folder);
        install(pip.arg("--only-binary").arg(":all:").args(PACKAGES))?;
        fs::write(&mark, &wanted)?;
    }
    say(&format!("package: {wanted}"));
    Ok(folder)
}

fn python() -> Command {
    Command::new("python3")
}

/// `pip install` into a folder: needs no environment, which Debian's Python makes only with another package.
fn pip(folder: &Path) -> Command {
    let mut pip = python();
    pip.args(["-m", "pip", "install", "--quiet", "--upgrade", "--target"]);
    pip.arg(folder);
    pip
}

/// The program, with which the package's results are compared, and all libraries. An example lets cargo choose features as it does for
/// the tests, so that nothing is compiled again.
const BUILT: &str = "--lib --bin ihd --example pages";

/// Builds the wheel, installs it and runs its tests; `full` builds it as `pip install ./python` does.
pub fn test(on: &Workspace, full: bool) -> anyhow::Result<()> {
    let tools = tools(on)?;
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
        .env("IHD_PROGRAM", on.program("ihd"))
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
        let cargo = of_whole_workspace(on, &mut build)?;
        build.env("CARGO", cargo.join("cargo"));
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

/// Writes a cargo for maturin, gives `maturin` the environment of every build here, and returns the folder of that cargo.
///
/// maturin builds the package alone; its 200 dependencies would be compiled again, with the features that it alone needs.
fn of_whole_workspace(on: &Workspace, maturin: &mut Command) -> anyhow::Result<PathBuf> {
    let whole = on.whole(
        "build",
        &format!("{BUILT} --message-format json-render-diagnostics"),
    );
    for (name, value) in whole.get_envs() {
        match value {
            Some(value) => maturin.env(name, value),
            None => maturin.env_remove(name),
        };
    }
    let words = |command: &Command| {
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        words
            .map(|word| format!("'{}'", word.display()))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let (whole, cargo) = (words(&whole), words(&on.cargo([""; 0])));
    let script = format!(
        "#!/bin/sh\n\
         # As in .cargo/config.toml.\n\
         unset CARGO PYO3_PYTHON PYO3_CONFIG_FILE PYO3_ENVIRONMENT_SIGNATURE\n\
         case $1 in\n\
         # Of other packages maturin knows nothing.\n\
         rustc) {whole} > \"$0.messages\"; status=$?; grep ihd_python \"$0.messages\"; exit $status ;;\n\
         # Without it the crates of every platform are downloaded.\n\
         metadata) exec {cargo} \"$@\" --filter-platform \"$(rustc --print host-tuple)\" ;;\n\
         *) exec {cargo} \"$@\" ;;\n\
         esac\n"
    );
    let folder = on.target.join("python/bin");
    fs::create_dir_all(&folder)?;
    let path = folder.join("cargo");
    fs::write(&path, script)?;
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755))?;
    Ok(folder)
}
