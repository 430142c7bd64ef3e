//! `ihd doctor`: diagnosis of a board and of the machine it is connected to.

#[cfg(feature = "daemon")]
mod certificate;
mod device;
#[cfg(feature = "daemon")]
mod store;
mod text;

use std::io::{BufRead, IsTerminal, stdin};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args};
use ihd_doctor::machine::{self, LocalSystem, System};
use ihd_doctor::{Check, CheckGroup, CheckResult, Report, board, firmware, first_switching};
use ihd_flash::{Image, ImageError};
use ihd_link::Client;
use ihd_shared::wire::hello::CAP_SIMULATED;
use ihd_survey::calibration::ReferenceLoad;

use super::global::Global;
use super::output::complain;
use super::simulated::SimulatedHobArgs;
use super::{interrupt, output};

/// Find out what is wrong with a board, and with the machine it is plugged into.
///
/// DEV is an address, tcp:HOST:PORT, usb, usb:SERIAL, serial:PATH or sim, or a name of the configuration. Without DEV
/// the machine is looked at, and the one board that is found there. Nothing is switched on without --first-switching.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("asks").multiple(true))]
#[command(after_help = "Examples:\n  \
    ihd doctor\n  \
    ihd doctor serial:/dev/ttyACM0 --json\n  \
    sudo ihd doctor --fix                        (installs the udev rule)\n  \
    ihd doctor usb --first-switching             (30 to 60 V, limit 1 A, on the DC link; asks before)\n  \
    ihd doctor sim                               (what it says of the simulated hob)\n\n\
    Every check passes, fails, or is not tested and says why: docs/bring-up.md.\n\
    Exit codes: 0 nothing failed, 1 a check failed, 2 wrong usage, 3 no device, or it was lost")]
pub struct DoctorArgs {
    /// The device
    #[arg(value_name = "DEV")]
    device: Option<String>,
    /// Install the udev rule that lets you use boards and probes without being root, and have udev read it
    #[arg(long, group = "asks")]
    fix: bool,
    /// Switch for some seconds with the least power from a current-limited bench supply, and look at the samples
    #[arg(long, group = "asks")]
    first_switching: bool,
    /// Do not ask before the first switching and the udev rule
    #[arg(long, requires = "asks")]
    yes: bool,
    /// Known load, for the skew of the channels: r=OHM,l=HENRY, or no-pot,r=OHM
    #[arg(long, value_name = "REF", value_parser = super::calibrate::reference, requires = "first_switching")]
    reference: Option<ReferenceLoad>,
    /// The image that should run; without one what this program carries, or the checkout's
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
    #[command(flatten)]
    simulated: SimulatedHobArgs,
}

/// Error with the exit code of the command, after the report was printed.
#[derive(Debug, thiserror::Error)]
pub enum ChecksFailed {
    /// Checks failed: exit code 1.
    #[error("{0} of the checks failed")]
    Failed(usize),
    /// No device: exit code 3.
    #[error("{0}")]
    NoDevice(String),
}

impl DoctorArgs {
    /// Makes the checks and prints the report.
    ///
    /// # Errors
    /// [`ChecksFailed`] if a check failed or no device was found; wrong usage; errors of `--fix`.
    pub fn run(&self, global: &Global) -> Result<()> {
        // Checked first: a requested image exists, and DEV is valid.
        let image = match &self.image {
            Some(path) => Image::read(path).map_err(anyhow::Error::from).map(Ok)?,
            None => Image::choose(None).map_err(|why| match why {
                ImageError::None => {
                    "no image at hand (--image, or cargo xtask firmware)".to_owned()
                }
                why => why.to_string(),
            }),
        };
        let choice = self.device_choice(global)?;
        let system = LocalSystem::new(as_root());
        // All answers before anything is done.
        if self.fix {
            on_linux(&system)?;
            if !self.yes && !confirmed(BEFORE_FIX, "yes", global.json)? {
                return Ok(());
            }
        }
        if self.first_switching && !self.yes && !confirmed(BEFORE_SWITCHING, "switch", global.json)?
        {
            return Ok(());
        }
        if self.fix {
            fix(&system, global.json)?;
        }
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let boards = match &choice {
            Some(_) => Vec::new(),
            None => machine::boards(&system),
        };
        let name = self.device.clone().or_else(|| match boards.as_slice() {
            [one] => Some(one.clone()),
            _ => None,
        });
        let mut report = Report::new(name.clone());
        #[cfg_attr(not(feature = "daemon"), expect(unused_mut))]
        let mut checks = machine::checks(&system);
        #[cfg(feature = "daemon")]
        {
            checks.push(store::check(global.config.as_deref()));
            checks.extend(certificate::check(global.config.as_deref()));
        }
        report.add(CheckGroup {
            name: "machine",
            checks,
        });
        let none = self.examine(&mut report, choice, &boards, &image, stop);
        print(&report, global.json)?;
        if let Some(why) = none {
            return Err(ChecksFailed::NoDevice(why).into());
        }
        match report.counts.fail {
            0 => Ok(()),
            failed => Err(ChecksFailed::Failed(failed).into()),
        }
    }

    /// Groups of the device; with the reason why there is none, or why it was lost.
    fn examine(
        &self,
        report: &mut Report,
        choice: Option<device::DeviceChoice>,
        boards: &[String],
        image: &Result<Image, String>,
        stop: &AtomicBool,
    ) -> Option<String> {
        let choice = match (choice, boards) {
            (Some(choice), _) => Ok(choice),
            (None, [one]) => one
                .parse()
                .map(device::DeviceChoice::Spec)
                .map_err(|e| format!("{e}")),
            (None, []) => Err("no board was found: ihd doctor DEV names one".to_owned()),
            (None, all) => Err(format!(
                "more than one board: ihd doctor DEV, with one of {}",
                all.join(", ")
            )),
        };
        let connected = choice.and_then(|choice| {
            let connected = choice.connect(&self.simulated);
            connected.map_err(|error| super::message(&error))
        });
        let mut client = match connected {
            Ok(client) => client,
            Err(why) => {
                self.not_connected(report, &why);
                return Some(why);
            }
        };
        let examined = board::examine(&mut client);
        let facts = examined.facts.as_ref().map_err(String::as_str);
        let mut checks = vec![Check::pass("connection", client.describe())];
        checks.extend(firmware::checks(
            &client,
            facts,
            image.as_ref().map_err(String::as_str),
        ));
        report.add(CheckGroup {
            name: "firmware",
            checks,
        });
        report.add(CheckGroup {
            name: "board",
            checks: examined.checks,
        });
        let mut lost = examined.lost.filter(|why| why != board::HEATS);
        if self.first_switching {
            lost = self.switch(report, &mut client, lost, stop);
        }
        report.ended_by.clone_from(&lost);
        lost
    }

    /// Makes the first switching, unless a check forbids it or is missing.
    fn switch(
        &self,
        report: &mut Report,
        client: &mut Client,
        lost: Option<String>,
        stop: &AtomicBool,
    ) -> Option<String> {
        let is_simulated = client.hello().capabilities & CAP_SIMULATED != 0;
        let against = lost
            .clone()
            .or_else(|| reason_against_switching(report, is_simulated));
        let (checks, ended) = match against {
            Some(why) => {
                let none = |name| Check::not_tested(name, &why);
                (first_switching::NAMES.into_iter().map(none).collect(), lost)
            }
            None => first_switching::run(client, self.reference, stop),
        };
        report.add(CheckGroup {
            name: "first_switching",
            checks,
        });
        ended
    }

    /// Adds the device's checks as not tested.
    fn not_connected(&self, report: &mut Report, why: &str) {
        let connection = match self.device.is_some() || report.device.is_some() {
            true => Check::fail(
                "connection",
                why,
                "The checks of the machine say more. Where the daemon has the device: stop it, or ask it (ihd device)",
            ),
            false => Check::not_tested("connection", why),
        };
        let mut checks = vec![connection];
        let none = |name| Check::not_tested(name, "no device");
        checks.extend(["protocol", "version", "image"].map(none));
        report.add(CheckGroup {
            name: "firmware",
            checks,
        });
        report.add(CheckGroup {
            name: "board",
            checks: board::NAMES.map(none).into(),
        });
        if self.first_switching {
            report.add(CheckGroup {
                name: "first_switching",
                checks: first_switching::NAMES.map(none).into(),
            });
        }
    }

    fn device_choice(&self, global: &Global) -> Result<Option<device::DeviceChoice>> {
        let Some(name) = &self.device else {
            return Ok(None);
        };
        #[cfg(feature = "daemon")]
        let choice = device::of_name(name, global.config.as_deref())?;
        #[cfg(not(feature = "daemon"))]
        let (choice, _) = (device::of_name(name)?, global);
        Ok(Some(choice))
    }
}

/// Checks without which the bridge is not switched.
const NEEDED: [&str; 5] = ["idle", "comparators", "flash_crc", "option_bytes", "clocks"];

/// Returns the needed check that failed or, on a board, was not made: a simulated hob has neither comparators nor flash.
fn reason_against_switching(report: &Report, is_simulated: bool) -> Option<String> {
    NEEDED
        .into_iter()
        .find_map(|name| match report.check(name).map(|check| check.verdict) {
            Some(CheckResult::Pass) => None,
            Some(CheckResult::Fail) => Some(format!("the check `{name}` failed")),
            Some(CheckResult::NotTested) | None => {
                (!is_simulated).then(|| format!("the check `{name}` was not made"))
            }
        })
}

fn print(report: &Report, json: bool) -> Result<()> {
    match json {
        true => output::json(report),
        false => output::text(&text::render(report)),
    }
}

/// Command line for installing the rule as root: `sudo` does not search a user's own folders for programs.
fn as_root() -> String {
    let program = std::env::current_exe();
    let program = program.map_or_else(|_| "ihd".to_owned(), |path| path.display().to_string());
    format!("sudo {program} doctor --fix")
}

fn on_linux(system: &LocalSystem) -> Result<()> {
    ensure_usage!(
        system.os() == machine::Os::Linux,
        "--fix installs a udev rule, which only Linux has; `ihd doctor` says what else to do"
    );
    Ok(())
}

fn fix(system: &LocalSystem, json: bool) -> Result<()> {
    let mut run = |program: &str, arguments: &[&str]| {
        let status = Command::new(program).args(arguments).status()?;
        match status.success() {
            true => Ok(()),
            false => Err(std::io::Error::other(status.to_string())),
        }
    };
    let path = machine::install(Path::new("/"), &system.as_root(), &mut run)?;
    let text = format!(
        "installed {}; plug boards and probes in again",
        path.display()
    );
    match json {
        // Standard output carries the JSON document only.
        true => complain(format_args!("ihd: {text}")),
        false => say!("{text}")?,
    }
    Ok(())
}

/// Conditions of the first switching.
const BEFORE_SWITCHING: &str = "First switching: the bridge will switch for up to 5 s with the least power, at 80 kHz.\n\
    \n  \
    - DC supply of 30 to 60 V, limit 1 A, isolated output, on DC+ and DC-; not the mains, F1 out\n  \
    - 24 V~ on L and N for the zero crossings\n  \
    - coil, and a ferromagnetic pot on it; nothing else near the coil\n  \
    - USB isolator between the board and this computer\n  \
    - sections A to D of docs/bring-up.md are done\n\n\
    ^C switches off. Type `switch` to go on: ";

/// Consequences of `--fix`.
const BEFORE_FIX: &str = "--fix writes /etc/udev/rules.d/70-ihd.rules, removes an earlier 99-ihd.rules there, and has udev read its rules \
    again: whoever sits at this computer may then use boards and probes.\n\
    Type `yes` to go on: ";

/// Asks the user for permission, which `word` grants; returns `true` if granted.
fn confirmed(text: &str, word: &str, json: bool) -> Result<bool> {
    ensure_usage!(
        stdin().is_terminal() && !json,
        "doctor asks before it switches the bridge or changes this computer, and nobody can answer here: add --yes (for \
         --first-switching where all of docs/bring-up.md is done)"
    );
    output::text(text)?;
    let mut line = String::new();
    stdin()
        .lock()
        .read_line(&mut line)
        .context("cannot read the answer")?;
    if line.trim() == word {
        return Ok(true);
    }
    say!("nothing was done")?;
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board whose firmware does not know the test of its trip was switched all the same.
    #[test]
    fn a_board_is_switched_after_all_needed_checks_alone() {
        let report = |comparators: Check| {
            let mut report = Report::new(None);
            let others = NEEDED.into_iter().filter(|name| *name != "comparators");
            let others = others.map(|name| Check::pass(name, "as it should be"));
            report.add(CheckGroup {
                name: "board",
                checks: others.chain([comparators]).collect(),
            });
            report
        };
        let name = "comparators";
        let passed = report(Check::pass(name, "both tripped"));
        let failed = report(Check::fail(name, "no trip", "no voltage on the bus"));
        let missing = report(Check::not_tested(name, "unknown message"));
        for (report, on_board, on_simulated) in [
            (&passed, None, None),
            (&failed, Some("failed"), Some("failed")),
            (&missing, Some("was not made"), None),
        ] {
            for (is_simulated, reason) in [(false, on_board), (true, on_simulated)] {
                let found = reason_against_switching(report, is_simulated);
                let expected = reason.map(|reason| format!("the check `comparators` {reason}"));
                assert_eq!(found, expected);
            }
        }
        let empty = Report::new(None);
        assert!(reason_against_switching(&empty, false).is_some());
    }
}
