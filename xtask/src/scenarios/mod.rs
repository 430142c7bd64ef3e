//! `cargo xtask scenarios`: every file of tests/scenarios through the ihd binary, against its limits.

mod limits;
mod table;
mod variants;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use std::{fs, thread};

use anyhow::{Context, ensure};

use self::limits::{Checked, Record};
use self::variants::Variant;
use crate::workspace::{Workspace, run as run_command};

const DIRECTORY: &str = "tests/scenarios";

/// A file with its variants.
pub struct Scenario {
    /// Folder and name without ending, such as `sags/dropout`.
    pub name: String,
    /// What it shows, by the file.
    pub title: String,
    /// Its runs.
    pub variants: Vec<Variant>,
}

/// What came of a run.
struct Ran {
    scenario: usize,
    variant: usize,
    checked: anyhow::Result<Vec<Checked>>,
}

/// Runs the scenarios whose name contains `only`; writes docs/control.md and the figures, unless there is
/// `only`, `quick` or `check`.
pub fn run(
    workspace: &Workspace,
    only: Option<&str>,
    quick: bool,
    check: bool,
) -> anyhow::Result<()> {
    // The binary of the tests, which are built with other features than `cargo build` would: a release
    // build takes five minutes and makes it a third faster.
    run_command(&mut workspace.whole("test", "--no-run --test it"))?;
    let ihd = workspace.target.join("debug").join("ihd");
    let mut scenarios = read_all(&workspace.root.join(DIRECTORY))?;
    scenarios.retain(|s| only.is_none_or(|only| s.name.contains(only)));
    if quick {
        scenarios.iter_mut().for_each(|s| s.variants.truncate(1));
    }
    ensure!(!scenarios.is_empty(), "no scenario of that name");
    let started = Instant::now();
    let work = workspace.target.join("scenarios");
    fs::create_dir_all(&work)?;
    let ran = run_all(&ihd, &work, &scenarios);
    let results: Vec<table::Result> = scenarios
        .iter()
        .enumerate()
        .map(|(n, scenario)| table::Result::of(scenario, &ran_of(&ran, n)))
        .collect();
    for result in &results {
        print!("{}", result.text());
    }
    println!(
        "{} runs in {:.0} s",
        ran.len(),
        started.elapsed().as_secs_f64()
    );
    let whole = only.is_none() && !quick;
    if whole && !check {
        draw(&ihd, &work, workspace, &scenarios)?;
    }
    if whole {
        table::document(workspace, &results, !check)?;
    }
    let missed = results.iter().map(table::Result::missed).sum::<usize>();
    ensure!(missed == 0, "{missed} limits missed");
    Ok(())
}

fn ran_of(ran: &[Ran], scenario: usize) -> Vec<(usize, &anyhow::Result<Vec<Checked>>)> {
    let own = ran.iter().filter(|r| r.scenario == scenario);
    let mut own: Vec<_> = own.map(|r| (r.variant, &r.checked)).collect();
    own.sort_by_key(|(variant, _)| *variant);
    own
}

/// Every file, in order of its name.
fn read_all(directory: &Path) -> anyhow::Result<Vec<Scenario>> {
    let mut files = Vec::new();
    for family in fs::read_dir(directory).with_context(|| directory.display().to_string())? {
        let family = family?.path();
        if family.is_dir() {
            for file in fs::read_dir(&family)? {
                files.push(file?.path());
            }
        }
    }
    files.retain(|file| file.extension().is_some_and(|e| e == "toml"));
    files.sort();
    files.iter().map(|file| read(directory, file)).collect()
}

fn read(directory: &Path, file: &Path) -> anyhow::Result<Scenario> {
    let name = file.strip_prefix(directory)?.with_extension("");
    let text = fs::read_to_string(file)?;
    let parse = || -> anyhow::Result<_> {
        let table: toml::Table = toml::from_str(&text)?;
        let title = table.get("title").and_then(toml::Value::as_str);
        let title = title.context("no title")?.to_owned();
        Ok((title, variants::of(table)?))
    };
    let (title, variants) = parse().with_context(|| file.display().to_string())?;
    Ok(Scenario {
        name: name.to_string_lossy().replace('\\', "/"),
        title,
        variants,
    })
}

/// Runs every variant, as many at a time as the machine has cores.
fn run_all(ihd: &Path, work: &Path, scenarios: &[Scenario]) -> Vec<Ran> {
    let jobs: Vec<(usize, usize)> = scenarios
        .iter()
        .enumerate()
        .flat_map(|(s, scenario)| (0..scenario.variants.len()).map(move |v| (s, v)))
        .collect();
    let (next, ran) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let worker = || {
        while let Some(&(scenario, variant)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let of = &scenarios[scenario];
            let file = work.join(format!("{}-{variant}.toml", of.name.replace('/', "-")));
            let checked = run_one(ihd, &file, &of.variants[variant]);
            let missed = match &checked {
                Ok(all) => all.iter().filter(|c| !c.ok).count(),
                Err(_) => 1,
            };
            let verdict = if missed == 0 { "" } else { "  missed" };
            eprintln!("{}: {}{verdict}", of.name, of.variants[variant].name);
            let done = Ran {
                scenario,
                variant,
                checked,
            };
            ran.lock().unwrap_or_else(|e| e.into_inner()).push(done);
        }
    };
    let cores = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| (0..cores).for_each(|_| drop(scope.spawn(worker))));
    ran.into_inner().unwrap_or_else(|e| e.into_inner())
}

fn run_one(ihd: &Path, file: &PathBuf, variant: &Variant) -> anyhow::Result<Vec<Checked>> {
    fs::write(file, toml::to_string(&variant.file)?)?;
    let mut command = Command::new(ihd);
    let output = command.arg("scenario").arg(file).arg("--json").output()?;
    ensure!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr).trim()
    );
    let record: Record = serde_json::from_slice(&output.stdout)?;
    let limits = variant.file.get("limits").and_then(toml::Value::as_table);
    limits::check(limits.context("no [limits]")?, &record)
}

/// One figure a family: the first variant of its first file.
fn draw(
    ihd: &Path,
    work: &Path,
    workspace: &Workspace,
    scenarios: &[Scenario],
) -> anyhow::Result<()> {
    let mut last = "";
    for scenario in scenarios {
        let family = table::family(&scenario.name);
        if family == last {
            continue;
        }
        last = family;
        let file = work.join(format!("{}-0.toml", scenario.name.replace('/', "-")));
        let figure = workspace.root.join(table::figure(family));
        fs::create_dir_all(figure.parent().context("no folder")?)?;
        let mut command = Command::new(ihd);
        run_command(command.arg("scenario").arg(file).arg("--plot").arg(figure))?;
    }
    Ok(())
}
