//! `ihd trainer`: identifies a hob's load and updates its lookup.

use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use ihd_capture::{OpenOptions, open};
use ihd_link::{Client, DeviceSpec, LinkError};
use ihd_shared::fault::Fault;
use ihd_shared::sampling::Scales;
use ihd_shared::wire::messages::{Pot, State, Telemetry};
use ihd_signal::printable::printable;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_survey::{Hints, Survey};
use ihd_train::replay::board_segments;
use ihd_train::{
    RecordedHalfCycle, RunFailure, RunOptions, RunProgress, RunReport, TrainingSource, TruthSource,
    run,
};
use indicatif::{ProgressBar, ProgressStyle};

#[cfg(feature = "daemon")]
use super::demonstration::Demonstration;
use super::global::Global;
use super::network_args::NetworkArgs;
#[cfg(feature = "daemon")]
use super::serve::ServeMode;
use super::simulate::quantity::power_w;
use super::simulated::SimulatedHobArgs;
use super::{interrupt, output};
use crate::report::{trained, training};

/// Limit of runs in one store.
const MAX_RUNS: u32 = 9_999;

/// Identifies the load of a hob with a PINN and pushes the R, L lookup to its controller.
///
/// The default device is a simulated hob whose controller is the firmware itself.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd trainer\n  \
    ihd trainer --power 1500 --network backend=ndarray --json\n  \
    ihd trainer --device tcp:127.0.0.1:4711 --follow\n  \
    ihd trainer --replay capture.mcap\n  \
    ihd trainer --ui                     (the page in a browser, with a simulated hob that heats)\n\n\
    Every end leaves the hob off, and what was found until then is printed.\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 device or link, 4 the device does not heat (fault, no pot),\n\
    5 nothing fit for the lookup")]
pub struct TrainerArgs {
    /// The device: sim, tcp:HOST:PORT, usb, usb:SERIAL or serial:PATH.
    #[arg(long, value_name = "DEVICE", default_value = "sim")]
    device: DeviceSpec,
    /// Powers to heat with, in watt, one operating point each.
    #[arg(
        long,
        value_name = "W,W,…",
        value_delimiter = ',',
        default_value = "1500,2000,1000,700,1500",
        value_parser = power_w
    )]
    power: Vec<u16>,
    /// Instead of heating, replay the half-cycles of this capture through the device, its power outputs locked off
    #[arg(long, value_name = "FILE", conflicts_with_all = ["power", "follow"])]
    replay: Option<PathBuf>,
    /// Folder in which each run gets a folder of its own, for the recording, the lookups and the
    /// figure; none: nothing is written to disk.
    #[arg(long, value_name = "DIR|none", default_value = "ihd-store")]
    store: PathBuf,
    /// Go on at the last power until ^C, and push a lookup whenever the load has changed. A fault, a lifted
    /// pot or a full disk is a line; a cut link is made again for a minute.
    #[arg(long)]
    follow: bool,
    #[command(flatten)]
    network: NetworkArgs,
    #[command(flatten)]
    simulated: SimulatedHobArgs,
    #[cfg(feature = "daemon")]
    #[command(flatten)]
    serve: super::serve::ServeArgs,
}

impl TrainerArgs {
    /// Connects, trains, reports.
    pub fn run(&self, global: &Global) -> Result<()> {
        #[cfg(feature = "daemon")]
        match self.serve.mode(global)? {
            ServeMode::Daemon => return self.serve.run(global),
            ServeMode::Demonstration => return self.demonstrate(global),
            ServeMode::None => {}
        }
        let pinn = self.network.config()?;
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let bar = progress_bar();
        let mut truth: TruthSource = None;
        let mut simulated = None;
        let config = self.simulated.config()?;
        let transport = self.device.open(|| {
            let hob = SharedHob::new(SimHob::new(&config));
            let known = hob.clone();
            simulated = Some(hob.clone());
            truth = Some(Box::new(move |half_cycle| known.truth(half_cycle)));
            Box::new(hob)
        })?;
        let client = Client::connect(transport)?;
        let scales = client.front_end().scales();
        let reopen = || self.reopen();
        let map_truth = || {
            bar.set_message("the truth of every cell");
            let truth = simulated.as_ref()?.lock().map_truth(&mut |_| ());
            let complain = |why: &_| line(&bar, &format!("the map is not judged: {why}"));
            truth.inspect_err(complain).ok()
        };
        let settings = RunOptions {
            source: self.source(scales)?,
            pinn,
            store: match self.store() {
                None => None,
                Some(store) => Some(new_run_folder(store)?),
            },
            follow: self.follow,
            stop: Some(stop),
            reopen: (self.device != DeviceSpec::Sim).then_some(&reopen),
            map_truth: (self.device == DeviceSpec::Sim).then_some(&map_truth),
        };
        let ended = run(client, truth, &settings, &mut |p| {
            show(&bar, self.follow, p)
        });
        bar.finish_and_clear();
        match ended {
            Ok(report) => self.print_report(&report, None, settings.store.as_deref(), global.json),
            Err(failed) => {
                let failed = *failed;
                self.print_report(
                    &failed.report,
                    Some(&failed),
                    settings.store.as_deref(),
                    global.json,
                )?;
                Err(failed.into())
            }
        }
    }

    /// Folder of the runs; `None` if nothing is to be written.
    fn store(&self) -> Option<&Path> {
        let store = self.store.as_path();
        (store != Path::new("none")).then_some(store)
    }

    /// Shows the page with a hob that heats by itself.
    #[cfg(feature = "daemon")]
    fn demonstrate(&self, global: &Global) -> Result<()> {
        // Checked before anything runs, for the messages of the command line.
        self.simulated.config()?;
        ensure_usage!(
            self.store().is_some(),
            "--store none: a daemon keeps what it learns; --store DIR names its folder"
        );
        ensure_usage!(
            self.device == DeviceSpec::Sim,
            "--ui heats by itself, which is for a simulated hob: `ihd trainer --daemon --ui` shows the page of {}, and heats nothing",
            self.device
        );
        let demonstration = Demonstration {
            sim: self.simulated.options()?.table(),
            powers_w: self.power.clone(),
            store: self.store.clone(),
            network: self.network.table()?,
        };
        self.serve.demonstrate(demonstration, global)
    }

    /// Opens a new link to the same device; a simulated hob in this process has none.
    fn reopen(&self) -> Result<Client, LinkError> {
        let device = self.device.to_string();
        let mut gone = false;
        let transport = self.device.open(|| {
            gone = true;
            Box::new(SharedHob::new(SimHob::new(&HobConfig::default())))
        })?;
        if gone {
            return Err(LinkError::Closed { device });
        }
        Client::connect(transport)
    }

    /// Prints and stores the results; `failed` is the error of a run that ended early.
    fn print_report(
        &self,
        report: &RunReport,
        failed: Option<&RunFailure>,
        store: Option<&Path>,
        json: bool,
    ) -> Result<()> {
        let has_points = !report.points.is_empty();
        if json {
            let mut json = training::json(report);
            if let Some(failed) = failed {
                json["error"] = failed.to_string().into();
            }
            output::json(&json)?;
        } else if has_points || failed.is_none() {
            output::text(&training::text(report))?;
        }
        let Some(store) = store.filter(|_| has_points) else {
            return Ok(());
        };
        match (
            trained::write(report, &store.join("identified.svg")),
            failed,
        ) {
            (Ok(()), _) => {}
            (Err(why), None) => return Err(why.into()),
            // The run's own error is reported.
            (Err(_), Some(_)) => return Ok(()),
        }
        if !json {
            say!(
                "kept     session.mcap, lookup-v*.json and identified.svg in {}",
                store.display()
            )?;
        }
        Ok(())
    }

    fn source(&self, scales: Scales) -> Result<TrainingSource> {
        let Some(path) = &self.replay else {
            return Ok(TrainingSource::Powers(self.power.clone()));
        };
        let capture = open(path, &OpenOptions::default())?;
        let survey = Survey::from_capture(&capture, &Hints::default())?;
        let segments = board_segments(&capture, survey.segments(&capture));
        let half_cycles: Vec<_> = segments
            .iter()
            .flat_map(|segment| RecordedHalfCycle::half_cycles(segment, scales, &capture.truth))
            .collect();
        ensure!(
            !half_cycles.is_empty(),
            "{} holds no whole mains half-cycle to replay",
            path.display()
        );
        Ok(TrainingSource::Replay(half_cycles))
    }
}

/// Creates the first `run-NNN` that does not exist yet, so that no run overwrites another.
fn new_run_folder(store: &Path) -> Result<PathBuf> {
    let cannot = |path: &Path| format!("cannot make the folder {}", path.display());
    fs::create_dir_all(store).with_context(|| cannot(store))?;
    for n in 1..=MAX_RUNS {
        let run = store.join(format!("run-{n:03}"));
        match fs::create_dir(&run) {
            Ok(()) => return Ok(run),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e).with_context(|| cannot(&run)),
        }
    }
    bail!(
        "{} holds {MAX_RUNS} runs already: move some away",
        store.display()
    )
}

fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    // The template is a constant; an invalid one would show in every test of this command.
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed:>4} {wide_msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// Prints a line above the bar, or on standard error if there is no bar.
fn line(bar: &ProgressBar, text: &str) {
    if bar.is_hidden() {
        output::complain(format_args!("{text}"));
    } else {
        bar.println(printable(text).to_string());
    }
}

/// Reason why the device does not heat.
fn waiting(t: &Telemetry) -> String {
    match (t.state, t.pot, t.fault) {
        (State::WaitingForPot, Pot::Unsuitable, _) => {
            "waiting: this pot cannot be heated, put a ferromagnetic one on".into()
        }
        (State::WaitingForPot, ..) => "waiting: put a pot on".into(),
        (_, _, Fault::NONE) => "pausing; it starts again by itself".into(),
        (_, _, fault) => format!("pausing, it starts again by itself ({fault})"),
    }
}

fn show(bar: &ProgressBar, follow: bool, progress: RunProgress<'_>) {
    match progress {
        RunProgress::Settling {
            asked_w,
            telemetry: t,
        } => bar.set_message(format!(
            "{asked_w} W: {:?}, {:.0} W at {:.2} kHz, pot {:?}",
            t.state,
            f64::from(t.power_mw) * 1e-3,
            f64::from(t.f_sw_hz) * 1e-3,
            t.pot
        )),
        RunProgress::Reduced(granted) => line(bar, &granted.to_string()),
        RunProgress::Waiting {
            asked_w,
            telemetry: t,
        } => line(bar, &format!("{asked_w} W: {}", waiting(t))),
        RunProgress::AwaitingWindow { point } => {
            bar.set_message(format!("{point}: waiting for a window"));
        }
        RunProgress::Training { seq, step } => bar.set_message(format!(
            "window {seq}: step {}, loss {:.3e}, change of R, L {:.1e}",
            step.iteration, step.loss, step.change
        )),
        RunProgress::Note { text } => line(bar, text),
        RunProgress::Rejected { seq, why } => {
            line(bar, &format!("window {seq} not used: {why}"));
        }
        RunProgress::LookupActive {
            version,
            observed_cells,
        } => {
            let text =
                format!("lookup {version} active on the device, {observed_cells} cells known");
            if follow {
                line(bar, &text);
            } else {
                bar.set_message(text);
            }
        }
    }
}
