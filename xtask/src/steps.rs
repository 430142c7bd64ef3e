//! The steps of `cargo xtask test`, in the order in which they run: the cheap ones first.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{bail, ensure};
use clap::ValueEnum;

use crate::images::{COUNTS, Image, MPS2_AN386, STM32G474};
use crate::setup::{self, Wanted, say};
use crate::workspace::{Workspace, run};
use crate::{
    board, budget, cycles, daemon, dashboard, emulator, fleet, fuzz, guest, hostile, licences,
    on_target, scenarios, ui_vendor,
};

const CLIPPY: &str = "--all-targets --features ihd-tests/emulator -- -D warnings";
/// The test of the firmware's image in QEMU.
const EMULATED_BOARD: &str =
    "--features ihd-tests/emulator --test it emulated_board --no-fail-fast";
const IMAGES: [Image; 3] = [STM32G474, MPS2_AN386, COUNTS];

/// One check of the project.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Step {
    /// Find or install the tools and the firmware's compiler
    Setup,
    /// Formatting, by rustfmt
    Fmt,
    /// The licence of every dependency against deny.toml; all of deny.toml where cargo-deny is installed
    Licences,
    /// What the page brings along (uPlot) against the hashes of npm's package, and against the package where npm is reachable
    Vendor,
    /// Clippy, every warning an error
    Clippy,
    /// All tests, by cargo-nextest where it is installed
    Tests,
    /// The first variant of each scenario in tests/scenarios against its limits
    Scenarios,
    /// Captures that try to fool the identification, in the short form
    Hostile,
    /// The daemon with hostile devices, bad links and kills, in the short form
    Daemon,
    /// The fleet on a real NATS server, in the short form
    Fleet,
    /// The dashboard in a real browser, in the short form
    Dashboard,
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
    /// On an emulated Cortex-M4F: the image, talked to by the host's own client, and the tests for the controller itself
    Emulator,
    /// The board's image as it is flashed, on an emulated STM32G474
    Board,
    /// The board's image on USB, driven by a Linux with the host program in it
    Usb,
    /// Each fuzz target for some seconds
    Fuzz,
}

/// What the steps share.
pub struct Session {
    /// The checkout.
    pub workspace: Workspace,
    /// Which compiler builds the firmware.
    pub wanted: Wanted,
}

impl Session {
    fn run(&self, step: Step) -> anyhow::Result<()> {
        match step {
            Step::Setup => self.set_up(),
            Step::Fmt => self.cargo("fmt --all --check"),
            Step::Licences => licences::check(&self.workspace),
            Step::Vendor => ui_vendor::check(&self.workspace, ui_vendor::can_fetch()),
            Step::Clippy => self.whole("clippy", CLIPPY),
            Step::Tests if setup::has_nextest(&self.workspace) => {
                self.whole("nextest run", "--no-fail-fast")
            }
            Step::Tests => self.whole("test", "--lib --bins --tests --no-fail-fast"),
            Step::Scenarios => scenarios::run(&self.workspace, None, true, true),
            Step::Hostile => hostile::test(&self.workspace, true),
            Step::Daemon => daemon::test(&self.workspace, None, false),
            Step::Fleet => fleet::test(&self.workspace, None, false),
            Step::Dashboard => {
                let short = dashboard::Extent {
                    only: None,
                    full: false,
                    screenshots: false,
                };
                dashboard::test(&self.workspace, &short)
            }
            Step::Doctests => self.whole("test", "--doc --no-fail-fast"),
            Step::Rustdoc => {
                let mut doc = self.workspace.whole("doc", "--no-deps");
                run(doc.env("RUSTDOCFLAGS", "-D warnings"))
            }
            Step::Firmware => self.firmware(),
            Step::Budget => self.budget(),
            Step::Cycles => self.cycles(false),
            Step::Emulator => self.emulator(),
            Step::Board => self.board(),
            Step::Usb => self.usb(),
            Step::Fuzz => fuzz::fuzz(&self.workspace, None, None),
        }
    }

    fn cargo(&self, line: &str) -> anyhow::Result<()> {
        run(&mut self.workspace.cargo(line.split(' ')))
    }

    fn whole(&self, subcommand: &str, rest: &str) -> anyhow::Result<()> {
        run(&mut self.workspace.whole(subcommand, rest))
    }

    /// Finds or installs what the other steps need.
    pub fn set_up(&self) -> anyhow::Result<()> {
        let tools = setup::tools(&self.workspace);
        let qemu = emulator::find(&self.workspace, emulator::ARM);
        let guest = emulator::find(&self.workspace, emulator::X86)
            .and_then(|_| guest::find(&self.workspace));
        // A missing tool must not keep the firmware's compiler from being looked for.
        let firmware = setup::firmware_toolchain(self.wanted)?;
        say(&format!("firmware: {}", firmware.describe()));
        let board = board::tools(&self.workspace);
        let browser = dashboard::tools().map(drop);
        let nats = fleet::server(&self.workspace).map(drop);
        tools
            .and(browser)
            .and(nats)
            .and(qemu.map(drop))
            .and(guest.map(drop))
            .and(board)
    }

    fn image(&self, image: Image) -> anyhow::Result<PathBuf> {
        let toolchain = setup::firmware_toolchain(self.wanted)?;
        image.build(&self.workspace, &toolchain)
    }

    /// Builds every image and says where it is.
    pub fn images(&self) -> anyhow::Result<()> {
        let toolchain = setup::firmware_toolchain(self.wanted)?;
        println!("built by {}", toolchain.describe());
        for image in IMAGES {
            let built = image.build(&self.workspace, &toolchain)?;
            println!("{}: {}", image.name, built.display());
        }
        Ok(())
    }

    fn firmware(&self) -> anyhow::Result<()> {
        self.images()?;
        let toolchain = setup::firmware_toolchain(self.wanted)?;
        // Clippy of the host's workspace does not see what only a board compiles.
        let lint = |image: &Image| image.lint(&self.workspace, &toolchain);
        IMAGES.iter().try_for_each(lint)
    }

    /// Prints what the board's image takes; an error where it takes more than it may.
    pub fn budget(&self) -> anyhow::Result<()> {
        let limits = budget::Limits::read(&self.workspace)?;
        let image = self.image(STM32G474)?;
        none_broken(&budget::check(&image, &limits)?)
    }

    /// Counts instructions; `write` puts them into docs/performance.md.
    pub fn cycles(&self, write: bool) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace, emulator::ARM)?;
        let limits = budget::Limits::read(&self.workspace)?;
        let counts = cycles::count(&qemu, &self.image(COUNTS)?)?;
        let table = cycles::table(&counts, &limits);
        println!("{table}");
        let mut broken = cycles::check(&counts, &limits);
        broken.extend(cycles::document(&self.workspace, &table, write)?);
        none_broken(&broken)
    }

    /// Has a Linux drive the board's image over USB.
    pub fn usb(&self) -> anyhow::Result<()> {
        guest::test(&self.workspace, &self.image(STM32G474)?)
    }

    /// The image as it is flashed on the emulated board.
    pub fn board(&self) -> anyhow::Result<()> {
        board::test(&self.workspace, &self.image(STM32G474)?)
    }

    /// The emulated board as a process; `image` or the one of this checkout.
    pub fn hob(&self, image: Option<PathBuf>, options: &[String]) -> anyhow::Result<()> {
        let image = match image {
            // xtask's cargo starts in the workspace's root.
            Some(image) => std::path::absolute(image)?,
            None => self.image(STM32G474)?,
        };
        board::hob(&self.workspace, &image, options)
    }

    fn emulator(&self) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace, emulator::ARM)?;
        let image = self.image(MPS2_AN386)?;
        let mut test = self.workspace.whole("test", EMULATED_BOARD);
        run(test.env("IHD_EMULATED_IMAGE", image).env("IHD_QEMU", &qemu))?;
        let toolchain = setup::firmware_toolchain(self.wanted)?;
        on_target::in_emulator(&self.workspace, &toolchain, &qemu)
    }

    /// The tests for the controller itself: in QEMU, and on a board where there is one.
    pub fn target_tests(&self) -> anyhow::Result<()> {
        let qemu = emulator::find(&self.workspace, emulator::ARM)?;
        let toolchain = setup::firmware_toolchain(self.wanted)?;
        on_target::in_emulator(&self.workspace, &toolchain, &qemu)?;
        on_target::on_board(&self.workspace, &toolchain)
    }
}

fn none_broken(broken: &[String]) -> anyhow::Result<()> {
    let list = broken.join("\n  ");
    ensure!(broken.is_empty(), "outside firmware/budget.toml:\n  {list}");
    Ok(())
}

/// The steps to run: those of `only`, or all, without those of `skip`; always in their own order.
pub fn select(only: &[Step], skip: &[Step]) -> anyhow::Result<Vec<Step>> {
    let all = Step::value_variants().iter().copied();
    let asked = all.filter(|step| only.is_empty() || only.contains(step));
    let chosen: Vec<_> = asked.filter(|step| !skip.contains(step)).collect();
    ensure!(!chosen.is_empty(), "--only and --skip leave no step to run");
    Ok(chosen)
}

/// Runs `steps` one after the other, each under a heading, and closes with a table; an error where one failed.
pub fn run_all(session: &Session, steps: &[Step], fail_fast: bool) -> anyhow::Result<()> {
    let (mut table, mut failed) = (String::new(), Vec::new());
    for (index, step) in steps.iter().enumerate() {
        // As it is typed.
        let name = format!("{step:?}").to_lowercase();
        if fail_fast && !failed.is_empty() {
            table += &format!("{name:<10} not run\n");
            continue;
        }
        println!("\n━━ {}/{} {name}", index + 1, steps.len());
        let started = Instant::now();
        let result = session.run(*step);
        let seconds = started.elapsed().as_secs_f64();
        let verdict = if result.is_ok() { "ok" } else { "FAILED" };
        println!("━━ {name} {verdict} in {seconds:.1} s");
        table += &format!("{name:<10} {verdict:<8} {seconds:>8.1}\n");
        if let Err(why) = result {
            let why = format!("\n{name}: {why:#}");
            eprintln!("{why}");
            failed.push(why);
        }
    }
    println!("\n━━ summary\nstep       result    seconds\n{table}");
    if !failed.is_empty() {
        let (number, why) = (failed.len(), failed.concat());
        bail!("{number} of {} steps failed{why}", steps.len());
    }
    Ok(())
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
}
