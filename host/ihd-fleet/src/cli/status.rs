//! `ihd-fleet status`.

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use ihd::cli::global::Global;
use ihd::report::table::TextTable;
use ihd::{ensure_usage, say};
use ihd_fleet::{names, status};
use ihd_model::{FleetEdge, FleetReport};
use serde::Serialize;

use super::dead::Which;
use super::{AccessArgs, StatusCheckFailed, ago};

/// Time in milliseconds after which a silent hob or edge counts as lost.
const SILENT_MS: i64 = 60_000;

/// State of the fleet, its hobs, what waits for a worker, or what was given up
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-fleet status --check\n  \
    ihd-fleet status devices --outdated --json\n  \
    ihd-fleet status dead --hob bench --delete")]
pub struct StatusArgs {
    /// Part that is shown
    #[arg(value_enum, value_name = "PART", default_value = "fleet")]
    part: Part,
    /// With fleet: end with code 7 where windows are dead, no worker is there for a backlog, an edge was not heard of for a minute, or one
    /// has an alarm: windows that are due for 10 min or without an answer for an hour, a name that is another store's
    #[arg(long)]
    check: bool,
    /// With devices: only those whose firmware differs from that of most of their board, or from `ihd-fleet init --build`
    #[arg(long)]
    outdated: bool,
    #[command(flatten)]
    which: Which,
    /// With dead: delete them for good
    #[arg(long)]
    delete: bool,
}

/// Part of the fleet's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Windows, results, backlog, dead, workers, edges
    Fleet,
    /// The hobs of all edges
    Devices,
    /// Windows that wait for a worker, by hob
    Backlog,
    /// Windows that were given up, with the reasons
    Dead,
}

fn report(access: &AccessArgs, global: &Global) -> Result<FleetReport> {
    access.with(global, async |access, context| {
        Ok(status::report(&context, &access.shown()).await?)
    })
}

impl StatusArgs {
    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let of = |part, is_given: bool, flag: &str| -> Result<()> {
            ensure_usage!(
                self.part == part || !is_given,
                "{flag}: not with this part; `ihd-fleet status --help` says with which"
            );
            Ok(())
        };
        of(Part::Fleet, self.check, "--check")?;
        of(Part::Devices, self.outdated, "--outdated")?;
        of(Part::Dead, self.which.is_given(), "--hob and --number")?;
        of(Part::Dead, self.delete, "--delete")?;
        ensure_usage!(!(self.delete && global.json), "--delete prints no JSON");
        match self.part {
            Part::Fleet => self.fleet(access, global),
            Part::Devices => self.devices(access, global),
            Part::Backlog => backlog(access, global),
            Part::Dead => self.which.show(self.delete, access, global),
        }
    }

    fn fleet(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let report = report(access, global)?;
        match global.json {
            true => say!("{}", serde_json::to_string_pretty(&report)?)?,
            false => say!("{}", report_text(&report).trim_end())?,
        }
        match amiss(&report) {
            Some(why) if self.check => Err(StatusCheckFailed(why).into()),
            _ => Ok(()),
        }
    }
}

fn amiss(report: &FleetReport) -> Option<String> {
    let silent: Vec<&str> = report
        .edges
        .iter()
        .filter(|edge| report.at_ms - edge.last_seen_ms > SILENT_MS)
        .map(|edge| edge.name.as_str())
        .collect();
    let alarms: Vec<String> = alarms(report).collect();
    match report {
        _ if !alarms.is_empty() => Some(alarms.join("; ")),
        r if r.dead > 0 => Some(format!(
            "{} windows were given up: ihd-fleet status dead",
            r.dead
        )),
        r if r.backlog > 0 && r.workers.is_empty() => Some(format!(
            "{} windows wait, and there is no worker: ihd-fleet worker",
            r.backlog
        )),
        _ if !silent.is_empty() => Some(format!("not heard of: {}", silent.join(", "))),
        _ => None,
    }
}

/// Alarms of all edges.
fn alarms(report: &FleetReport) -> impl Iterator<Item = String> {
    let of = |edge: &FleetEdge| {
        let name = edge.name.clone();
        let alarms = edge.alarms.clone().into_iter();
        alarms.map(move |alarm| format!("edge {name}: {alarm}"))
    };
    report.edges.iter().flat_map(of)
}

fn report_text(report: &FleetReport) -> String {
    let mut text = format!(
        "{}: {} windows ever, {} results, {} in the backlog, {} dead\n",
        report.server, report.windows, report.results, report.backlog, report.dead
    );
    let mut workers = TextTable::new(&["worker", "threads", "at", "done", "failed", "ihd", "seen"]);
    for worker in &report.workers {
        workers.row([
            worker.name.clone(),
            worker.threads.to_string(),
            worker.busy.to_string(),
            worker.done.to_string(),
            worker.failed.to_string(),
            worker.version.clone(),
            ago(worker.last_seen_ms),
        ]);
    }
    let mut edges = TextTable::new(&[
        "edge",
        "stored",
        "due",
        "sent",
        "answered",
        "learned here",
        "given up",
        "not for it",
        "learns",
        "ihd",
        "seen",
    ]);
    for edge in &report.edges {
        let states = &edge.states;
        let learns = if edge.delegates { "fleet" } else { "itself" };
        edges.row([
            edge.name.clone(),
            states.stored().to_string(),
            states.due.to_string(),
            states.sent.to_string(),
            states.answered.to_string(),
            states.learned_here.to_string(),
            (states.no_samples + states.dead).to_string(),
            states.not_for_fleet.to_string(),
            learns.to_owned(),
            edge.version.clone(),
            ago(edge.last_seen_ms),
        ]);
    }
    match report.workers.is_empty() {
        true => text.push_str("no worker: ihd-fleet worker\n"),
        false => text.push_str(&format!("\n{}", workers.render())),
    }
    if !report.edges.is_empty() {
        text.push_str(&format!("\n{}", edges.render()));
    }
    for alarm in alarms(report) {
        text.push_str(&format!("{alarm}\n"));
    }
    text.push_str(&format!(
        "\n{} hobs, {} of them outdated: ihd-fleet status devices",
        report.devices.len(),
        report.devices.iter().filter(|d| d.outdated).count()
    ));
    text
}

impl StatusArgs {
    fn devices(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let mut report = report(access, global)?;
        report.devices.retain(|d| d.outdated || !self.outdated);
        if global.json {
            return say!("{}", serde_json::to_string_pretty(&report.devices)?);
        }
        let mut table = TextTable::new(&[
            "hob", "edge", "state", "pot", "firmware", "", "protocol", "lookup", "seen",
        ]);
        for device in &report.devices {
            let outdated = if device.outdated { "outdated" } else { "" };
            table.row([
                device.name.clone(),
                device.edge.clone(),
                device.state.clone(),
                device.pot.clone(),
                device.build.clone(),
                outdated.to_owned(),
                format!("{}.{}", device.protocol.0, device.protocol.1),
                device.lookup_version.to_string(),
                ago(device.last_seen_ms),
            ]);
        }
        say!("{}", table.render().trim_end())
    }
}

#[derive(Serialize)]
struct Waiting {
    hob: String,
    windows: usize,
}

fn backlog(access: &AccessArgs, global: &Global) -> Result<()> {
    let waiting = access.with(global, async |_, context| {
        let stream = ihd_fleet::jetstream::stream(&context, names::WINDOWS).await?;
        let subjects = stream.info_with_subjects(names::window("*")).await;
        let mut subjects = subjects.context(names::WINDOWS)?;
        let mut waiting = Vec::new();
        while let Some(next) = futures_util::StreamExt::next(&mut subjects).await {
            let (subject, windows) = next.context(names::WINDOWS)?;
            let hob = subject.split('.').nth(2).unwrap_or_default().to_owned();
            waiting.push(Waiting { hob, windows });
        }
        waiting.sort_by(|a, b| (b.windows, &a.hob).cmp(&(a.windows, &b.hob)));
        Ok(waiting)
    })?;
    if global.json {
        return say!("{}", serde_json::to_string_pretty(&waiting)?);
    }
    let mut table = TextTable::new(&["hob", "windows"]);
    for of in &waiting {
        table.row([of.hob.clone(), of.windows.to_string()]);
    }
    match waiting.is_empty() {
        true => say!("nothing waits"),
        false => say!("{}", table.render().trim_end()),
    }
}
