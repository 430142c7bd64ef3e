//! The dashboard in a real browser: the page's own tests (`host/ui/tests`) and `tests/dashboard`, both in Node.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::{Context, ensure};

use crate::setup::{apt_get, say};
use crate::workspace::{Workspace, first_line, run};

/// Tests of the page's modules, which need no browser.
const OF_PAGE: &str = "host/ui/tests";
/// Those with a browser.
const OF_BROWSER: &str = "tests/dashboard";
/// Oldest Node whose test runner and browser driver work.
const NODE: u32 = 20;
/// Debian's name, Ubuntu's, Google's.
const BROWSERS: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];
/// Files of tests at a time: they wait more than they work. The long form measures alone.
const SHORT: &str = "--test-concurrency=2";
const ALONE: &str = "--test-concurrency=1";
/// What says which packages of npm are meant, and whether those that are there are.
const LOCK: &str = "package-lock.json";

/// What of the tests is run.
#[derive(Default)]
pub struct Extent<'a> {
    /// Those whose name contains this.
    pub only: Option<&'a str>,
    /// The long form.
    pub full: bool,
    /// Whether docs/dashboard gets new pictures.
    pub screenshots: bool,
}

/// Installs what is missing, builds `ihd`, and runs the tests.
pub fn test(on: &Workspace, extent: &Extent) -> anyhow::Result<()> {
    let browser = tools()?;
    let modules = modules(on)?;
    // What the step "tests" has built, its features included; built here only where that did not run.
    run(&mut on.whole("test", "--lib --bins --tests --no-run --quiet"))?;
    // Without --only: the page's own tests take two seconds.
    run(node(on).args(files(on, OF_PAGE, ".test.mjs")?))?;
    let mut test = node(on);
    test.arg(if extent.full { ALONE } else { SHORT });
    if let Some(name) = extent.only {
        test.arg(format!("--test-name-pattern={name}"));
    }
    test.args(files(on, OF_BROWSER, ".test.mjs")?);
    test.env("IHD_BIN", on.program())
        .env("IHD_CHROMIUM", browser)
        .env("IHD_DASHBOARD_MODULES", modules);
    if extent.full {
        test.env("IHD_DASHBOARD_FULL", "1");
    }
    if extent.screenshots {
        test.env("IHD_SCREENSHOTS", on.root.join("docs/dashboard"));
    }
    run(&mut test)
}

/// Finds Node, npm and a browser, or installs them; the browser's path.
pub fn tools() -> anyhow::Result<PathBuf> {
    let mut missing = Vec::new();
    for (program, package) in [("node", "nodejs"), ("npm", "npm")] {
        if version(program).is_none() {
            missing.push(package);
        }
    }
    if browser().is_none() {
        missing.push("chromium");
    }
    if !missing.is_empty() {
        apt_get(&missing).with_context(|| {
            format!(
                "the dashboard's tests need {}: install them",
                missing.join(", ")
            )
        })?;
    }
    let node = version("node").context("`node` is missing; install Node 20 or later")?;
    ensure!(
        major(&node).is_some_and(|major| major >= NODE),
        "the dashboard's tests need Node {NODE} or later, not {node}; https://nodejs.org has it"
    );
    version("npm").context("`npm` is missing; install it beside Node")?;
    let browser = browser().context("no Chromium: install it, or name one in IHD_CHROMIUM")?;
    say(&format!("dashboard: node {node}, {}", browser.display()));
    Ok(browser)
}

fn version(program: &str) -> Option<String> {
    first_line(Command::new(program).arg("--version"))
}

/// Of `v20.20.2`.
fn major(version: &str) -> Option<u32> {
    let digits = version.trim_start_matches('v').split('.').next()?;
    digits.parse().ok()
}

fn browser() -> Option<PathBuf> {
    if let Some(named) = env::var_os("IHD_CHROMIUM") {
        return Some(named.into());
    }
    let folders = env::var_os("PATH")?;
    let folders: Vec<_> = env::split_paths(&folders).collect();
    let mut all = BROWSERS.iter().flat_map(|name| {
        let places = folders.iter().map(|folder| folder.join(name));
        places.collect::<Vec<_>>()
    });
    all.find(|path| path.is_file())
}

/// npm's packages, beside the build: as the lock file in the source tree has them, to the hash.
fn modules(on: &Workspace) -> anyhow::Result<PathBuf> {
    let (from, to) = (on.root.join(OF_BROWSER), on.target.join("dashboard"));
    let wanted = fs::read(from.join(LOCK)).context(LOCK)?;
    let installed = to.join("installed");
    if fs::read(&installed).is_ok_and(|there| there == wanted) {
        return Ok(to);
    }
    fs::create_dir_all(&to)?;
    for file in ["package.json", LOCK] {
        fs::copy(from.join(file), to.join(file)).with_context(|| file.to_owned())?;
    }
    let mut install = Command::new("npm");
    // No package may run anything of its own.
    install.args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"]);
    run(install.current_dir(&to))?;
    fs::write(&installed, &wanted)?;
    Ok(to)
}

/// Node's test runner in the workspace's root; what follows are options, then files.
fn node(on: &Workspace) -> Command {
    let mut command = Command::new("node");
    command.current_dir(&on.root);
    command.args(["--test", "--test-reporter=spec"]);
    command
}

/// Files of a folder that end so, in order of their names.
fn files(on: &Workspace, folder: &str, end: &str) -> anyhow::Result<Vec<String>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(on.root.join(folder)).context(folder.to_owned())? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if name.ends_with(end) {
            let path = Path::new(folder).join(name);
            found.push(path.to_string_lossy().into_owned());
        }
    }
    ensure!(!found.is_empty(), "there is no test in {folder}");
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_of_node_is_read() {
        assert_eq!(major("v20.20.2"), Some(20));
        assert_eq!(major("v9.1.0"), Some(9));
        assert_eq!(major("node"), None);
    }
}
