//! The dashboard in a real browser: the page's own tests (`host/ui/tests`) and `tests/dashboard`, both in Node.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use anyhow::Context;

use crate::setup::{apt_get, say};
use crate::workspace::{Workspace, first_line, run};

/// Tests with a browser.
const OF_BROWSER: &str = "tests/dashboard";
/// Names of the browser by Debian, Ubuntu and Google.
const BROWSERS: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];
/// Report of the failed tests, in the target directory.
const FAILURES: &str = "dashboard/failures.tap";
/// Lock file of npm, which also shows if the installed packages are up to date.
const LOCK: &str = "package-lock.json";

/// Installs what is missing, builds `ihd`, and runs the tests; `full` is the long form.
pub fn test(on: &Workspace, full: bool) -> anyhow::Result<()> {
    let browser = tools()?;
    let modules = modules(on)?;
    // The step "tests" has built it, features included; this builds only if that step did not run.
    run(&mut on.whole("test", "--lib --bins --tests --no-run --quiet"))?;
    run(&mut node(on, "host/ui/tests/*.test.mjs"))?;
    // Test files run in parallel: they wait more than they compute. The long form measures, and therefore runs one at a time.
    let files = match full {
        true => "--test-concurrency=1 tests/dashboard/*.test.mjs",
        false => "--test-concurrency=3 tests/dashboard/*.test.mjs",
    };
    let mut test = node(on, files);
    test.env("IHD_BIN", on.program("ihd"))
        .env("IHD_CHROMIUM", browser)
        .env("IHD_DASHBOARD_MODULES", modules);
    if full {
        test.env("IHD_DASHBOARD_FULL", "1");
    }
    let failures = on.target.join(FAILURES);
    test.env("IHD_FAILURES", &failures);
    run(&mut test).with_context(|| failed_tests(&failures))
}

/// Returns the failed tests with their errors, for the end of a long log.
fn failed_tests(file: &Path) -> String {
    let mut inside = false;
    let of_failure = |line: &&str| {
        let line = line.trim_start();
        inside = line.starts_with("not ok") || inside && !line.starts_with("code:");
        inside
    };
    let text = fs::read_to_string(file).unwrap_or_default();
    text.lines()
        .filter(of_failure)
        .collect::<Vec<_>>()
        .join("\n")
}

/// Finds Node, npm and a browser, or installs them; returns the browser's path.
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
    version("npm").context("`npm` is missing; install it beside Node")?;
    let browser = browser().context("no Chromium: install it, or name one in IHD_CHROMIUM")?;
    say(&format!("dashboard: node {node}, {}", browser.display()));
    Ok(browser)
}

fn version(program: &str) -> Option<String> {
    first_line(Command::new(program).arg("--version"))
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

/// Installs npm's packages beside the build, pinned by the hashes of the lock file in the source tree.
fn modules(on: &Workspace) -> anyhow::Result<PathBuf> {
    let (from, to) = (on.root.join(OF_BROWSER), on.target.join("dashboard"));
    let lock = fs::read(from.join(LOCK)).context(LOCK)?;
    let installed = to.join("installed");
    if fs::read(&installed).is_ok_and(|there| there == lock) {
        return Ok(to);
    }
    fs::create_dir_all(&to)?;
    for file in ["package.json", LOCK] {
        fs::copy(from.join(file), to.join(file)).with_context(|| file.to_owned())?;
    }
    let mut install = Command::new("npm");
    // No package may run scripts.
    install.args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"]);
    run(install.current_dir(&to))?;
    fs::write(&installed, &lock)?;
    Ok(to)
}

/// Command of Node's test runner on files by a shell pattern, in the workspace's root.
fn node(on: &Workspace, files: &str) -> Command {
    let mut command = Command::new("sh");
    command.current_dir(&on.root).arg("-c");
    // The second report, in TAP, is for `failed_tests`.
    let reports = r#"--test-reporter=spec --test-reporter-destination=stdout --test-reporter=tap --test-reporter-destination="${IHD_FAILURES:-/dev/null}""#;
    command.arg(format!("exec node --test {reports} {files}"));
    command
}
