//! The steps of `cargo xtask test`, in the order in which they run: the cheap ones first.

use std::fmt;
use std::path::PathBuf;
use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::ValueEnum;

use crate::count::{Counts, Runner};
use crate::images::Image;
use crate::limits::Limits;
use crate::setup::{self, Wanted};
use crate::stream::run_and_count;
use crate::toolchain::FirmwareToolchain;
use crate::workspace::{Workspace, spelled};
use crate::{arrows, budget, cycles, emulator, house, licences};

/// One check of the project.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Step {
    /// Find or install the tools and the firmware's compiler
    Setup,
    /// Formatting, by rustfmt
    Fmt,
    /// The house's own rules: no unsafe outside the board, names, arrows between crates
    House,
    /// The licence of every dependency against deny.toml
    Licences,
    /// Clippy, every warning an error
    Clippy,
    /// All tests, by cargo-nextest where it is installed
    Tests,
    /// The examples in the documentation
    Doctests,
    /// The documentation builds, without broken links
    Rustdoc,
    /// The firmware's images build, for the board and for the emulator
    Firmware,
    /// Flash, RAM and panic paths of the board's image against firmware/budget.toml
    Budget,
    /// Instruction counts on an emulated Cortex-M4F against firmware/budget.toml
    Cycles,
    /// The image on an emulated Cortex-M4F, talked to by the host's own client
    Emulator,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.to_possible_value();
        f.write_str(value.as_ref().map_or("", |value| value.get_name()))
    }
}

/// How a step ended.
#[derive(Debug)]
pub enum Ended {
    Passed,
    /// And why.
    Failed(String),
    /// An earlier step failed under `--fail-fast`.
    NotRun,
}

/// A step and what came of it.
#[derive(Debug)]
pub struct Outcome {
    pub step: Step,
    pub ended: Ended,
    pub elapsed: Duration,
    /// For the steps that run tests.
    pub counts: Option<Counts>,
}

impl Outcome {
    pub fn failed(&self) -> bool {
        matches!(self.ended, Ended::Failed(_))
    }
}

/// What the steps share.
pub struct Session {
    workspace: Workspace,
    wanted: Wanted,
    /// Chosen once, by the set-up or by the first step that needs it.
    firmware: Option<Result<FirmwareToolchain, String>>,
}

impl Session {
    pub fn new(workspace: Workspace, wanted: Wanted) -> Self {
        Self {
            workspace,
            wanted,
            firmware: None,
        }
    }

    fn run(&mut self, step: Step) -> (anyhow::Result<()>, Option<Counts>) {
        let result = match step {
            Step::Setup => self.set_up(),
            Step::Fmt => self.cargo(&["fmt", "--all", "--check"]),
            Step::House => self.house(),
            Step::Licences => licences::check(&self.workspace),
            Step::Clippy => self.cargo(&[
                "clippy",
                "--workspace",
                "--all-targets",
                "--features",
                "ihd-tests/emulator",
                "--",
                "-D",
                "warnings",
            ]),
            Step::Tests => return self.tests(),
            Step::Doctests => return self.doctests(),
            Step::Rustdoc => self.rustdoc(),
            Step::Firmware => self.firmware(),
            Step::Budget => self.budget(),
            Step::Cycles => self.cycles(false),
            Step::Emulator => return self.emulator(),
        };
        (result, None)
    }

    fn cargo(&self, args: &[&str]) -> anyhow::Result<()> {
        succeed(&mut self.workspace.cargo(args))
    }

    fn set_up(&mut self) -> anyhow::Result<()> {
        let toolchain = setup::run(&self.workspace, self.wanted);
        self.firmware = Some(as_text(&toolchain));
        toolchain.map(drop)
    }

    fn house(&self) -> anyhow::Result<()> {
        let mut broken = house::check(self.workspace.root())?;
        broken.extend(arrows::check(&self.workspace)?);
        if !broken.is_empty() {
            bail!(
                "{} of the house's rules broken:\n  {}",
                broken.len(),
                broken.join("\n  ")
            );
        }
        Ok(())
    }

    fn tests(&self) -> (anyhow::Result<()>, Option<Counts>) {
        if setup::has_nextest(&self.workspace) {
            let args = ["nextest", "run", "--workspace", "--no-fail-fast"];
            self.run_tests(&args, Runner::Nextest)
        } else {
            let args = [
                "test",
                "--workspace",
                "--lib",
                "--bins",
                "--tests",
                "--no-fail-fast",
            ];
            self.run_tests(&args, Runner::Libtest)
        }
    }

    fn doctests(&self) -> (anyhow::Result<()>, Option<Counts>) {
        let args = ["test", "--workspace", "--doc", "--no-fail-fast"];
        self.run_tests(&args, Runner::Libtest)
    }

    fn run_tests(&self, args: &[&str], runner: Runner) -> (anyhow::Result<()>, Option<Counts>) {
        self.run_command(self.workspace.cargo(args), runner)
    }

    fn run_command(
        &self,
        mut command: Command,
        runner: Runner,
    ) -> (anyhow::Result<()>, Option<Counts>) {
        announce(&command);
        match run_and_count(&mut command, runner) {
            Ok((status, counts)) => (check(status, &command), Some(counts)),
            Err(why) => (Err(why), None),
        }
    }

    fn rustdoc(&self) -> anyhow::Result<()> {
        let mut command = self.workspace.cargo(["doc", "--workspace", "--no-deps"]);
        succeed(command.env("RUSTDOCFLAGS", "-D warnings"))
    }

    fn toolchain(&mut self) -> anyhow::Result<FirmwareToolchain> {
        let wanted = self.wanted;
        let toolchain = self
            .firmware
            .get_or_insert_with(|| as_text(&setup::firmware_toolchain(wanted)));
        toolchain.clone().map_err(anyhow::Error::msg)
    }

    /// The file of an image, built in this session.
    pub fn image(&mut self, image: Image) -> anyhow::Result<PathBuf> {
        let toolchain = self.toolchain()?;
        image.build(&self.workspace, &toolchain)
    }

    fn firmware(&mut self) -> anyhow::Result<()> {
        let toolchain = self.toolchain()?;
        println!("built by {}", toolchain.describe());
        for image in Image::ALL {
            self.image(image)?;
            // Clippy of the host's workspace does not see what only a board compiles.
            succeed(&mut image.lint(&self.workspace, &toolchain))?;
        }
        Ok(())
    }

    /// Prints what the board's image takes; an error where it takes more than it may.
    pub fn budget(&mut self) -> anyhow::Result<()> {
        let limits = Limits::read(&self.workspace)?;
        let image = self.image(Image::Stm32g474)?;
        none_broken(budget::check(&image, &limits)?)
    }

    /// Counts instructions; `write` puts them into docs/performance.md.
    pub fn cycles(&mut self, write: bool) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace)?;
        let limits = Limits::read(&self.workspace)?;
        let counts = cycles::count(&qemu, &self.image(Image::InstructionCounts)?)?;
        let table = cycles::table(&counts, &limits);
        println!("{table}");
        let mut broken = cycles::check(&counts, &limits);
        broken.extend(cycles::document(&self.workspace, &table, write)?);
        none_broken(broken)
    }

    fn emulator(&mut self) -> (anyhow::Result<()>, Option<Counts>) {
        let found = emulator::find(&self.workspace)
            .and_then(|qemu| Ok((qemu, self.image(Image::Mps2An386)?)));
        let (qemu, image) = match found {
            Ok(found) => found,
            Err(why) => return (Err(why), None),
        };
        // The whole workspace's features, as the tests before: what they built serves here too.
        let args = [
            "test",
            "--workspace",
            "--features",
            "ihd-tests/emulator",
            "--test",
            "emulated_board",
            "--no-fail-fast",
        ];
        let mut command = self.workspace.cargo(args);
        command
            .env("IHD_EMULATED_IMAGE", image)
            .env("IHD_QEMU", qemu);
        self.run_command(command, Runner::Libtest)
    }
}

fn none_broken(broken: Vec<String>) -> anyhow::Result<()> {
    if !broken.is_empty() {
        bail!("outside firmware/budget.toml:\n  {}", broken.join("\n  "));
    }
    Ok(())
}

/// The steps to run: those of `only`, or all, without those of `skip`; always in their own order.
pub fn select(only: &[Step], skip: &[Step]) -> anyhow::Result<Vec<Step>> {
    let all = Step::value_variants().iter().copied();
    let chosen: Vec<_> = all
        .filter(|step| only.is_empty() || only.contains(step))
        .filter(|step| !skip.contains(step))
        .collect();
    if chosen.is_empty() {
        bail!("--only and --skip leave no step to run");
    }
    Ok(chosen)
}

/// Runs `steps` one after the other, each under a heading.
pub fn run_all(session: &mut Session, steps: &[Step], fail_fast: bool) -> Vec<Outcome> {
    let mut outcomes: Vec<Outcome> = Vec::with_capacity(steps.len());
    for (index, &step) in steps.iter().enumerate() {
        if fail_fast && outcomes.iter().any(Outcome::failed) {
            outcomes.push(Outcome {
                step,
                ended: Ended::NotRun,
                elapsed: Duration::ZERO,
                counts: None,
            });
            continue;
        }
        println!("\n━━ {}/{} {step}", index + 1, steps.len());
        let outcome = run_one(session, step);
        let verdict = if outcome.failed() { "FAILED" } else { "ok" };
        println!(
            "━━ {step} {verdict} in {:.1} s",
            outcome.elapsed.as_secs_f64()
        );
        outcomes.push(outcome);
    }
    outcomes
}

fn run_one(session: &mut Session, step: Step) -> Outcome {
    let started = Instant::now();
    let (result, counts) = session.run(step);
    let ended = match result {
        Ok(()) => Ended::Passed,
        Err(why) => {
            let why = format!("{why:#}");
            eprintln!("{why}");
            Ended::Failed(why)
        }
    };
    Outcome {
        step,
        ended,
        elapsed: started.elapsed(),
        counts,
    }
}

fn succeed(command: &mut Command) -> anyhow::Result<()> {
    announce(command);
    let status = command
        .status()
        .with_context(|| format!("could not start `{}`", spelled(command)))?;
    check(status, command)
}

fn announce(command: &Command) {
    println!("$ {}", spelled(command));
}

fn check(status: ExitStatus, command: &Command) -> anyhow::Result<()> {
    if !status.success() {
        bail!("`{}` failed ({status}); see above", spelled(command));
    }
    Ok(())
}

/// Kept for a later step, which needs the reason again.
fn as_text<T: Clone>(result: &anyhow::Result<T>) -> Result<T, String> {
    result.as_ref().cloned().map_err(|why| format!("{why:#}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_steps_run_in_their_own_order_unless_told_otherwise() {
        assert_eq!(select(&[], &[]).unwrap(), Step::value_variants());
        let chosen = select(&[Step::Clippy, Step::Fmt], &[]).unwrap();
        assert_eq!(chosen, [Step::Fmt, Step::Clippy]);
        let chosen = select(&[Step::Clippy, Step::Fmt], &[Step::Fmt]).unwrap();
        assert_eq!(chosen, [Step::Clippy]);
        assert!(select(&[Step::Fmt], &[Step::Fmt]).is_err());
    }

    #[test]
    fn a_step_is_named_as_it_is_typed() {
        assert_eq!(Step::Licences.to_string(), "licences");
    }
}
