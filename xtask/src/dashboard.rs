//! The dashboard in a real browser: the page's own tests (`host/ui/tests`) and `tests/dashboard`, both in Node.

use std::path::PathBuf;
use std::process::Command;
use std::{env, fs};

use anyhow::Context;

use crate::setup::{program, say};
use crate::workspace::{Workspace, run};

/// Tests with a browser.
const OF_BROWSER: &str = "tests/dashboard";
/// Names of the browser by Debian, Ubuntu and Google.
const BROWSERS: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];
/// Lock file of npm, which also shows if the installed packages are up to date.
const LOCK: &str = "package-lock.json";

/// Installs what is missing, builds `ihd`, and runs the tests; `full` is the long form.
pub fn test(on: &Workspace, full: bool) -> anyhow::Result<()> {
    let browser = tools()?;
    let modules = modules(on)?;
    run(&mut node(on, "host/ui/tests/*.test.mjs"))?;
    // Test files run in parallel: they wait more than they compute. The long form measures, and therefore runs one at a time.
    let files = match full {
        true => "--test-concurrency=1 tests/dashboard/*.test.mjs",
        false => "--test-concurrency=3 tests/dashboard/*.test.mjs",
    };
    let mut test = node(on, files);
    test.env("IHD_BIN", on.program("ihd")?)
        .env("IHD_CHROMIUM", browser)
        .env("IHD_DASHBOARD_MODULES", modules);
    if full {
        test.env("IHD_DASHBOARD_FULL", "1");
    }
    run(&mut test)
}

/// Finds Node, npm and a browser, or installs them; returns the browser's path.
pub fn tools() -> anyhow::Result<PathBuf> {
    let node = program("node", "nodejs")?;
    program("npm", "npm")?;
    let browser = match browser() {
        Some(browser) => browser,
        None => program(BROWSERS[0], BROWSERS[0])
            .map(|_| BROWSERS[0].into())
            .context("or name another browser in IHD_CHROMIUM")?,
    };
    say(&format!("dashboard: node {node}, {}", browser.display()));
    Ok(browser)
}

/// The browser that IHD_CHROMIUM names, or the first on the PATH.
fn browser() -> Option<PathBuf> {
    let named = env::var_os("IHD_CHROMIUM").map(PathBuf::from);
    let path = env::var_os("PATH").unwrap_or_default();
    let on_path = BROWSERS
        .iter()
        .flat_map(|name| env::split_paths(&path).map(move |folder| folder.join(name)));
    named.or_else(|| on_path.into_iter().find(|path| path.is_file()))
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
    command.current_dir(&on.root);
    command.args([
        "-c",
        &format!("exec node --test --test-reporter=spec {files}"),
    ]);
    command
}
