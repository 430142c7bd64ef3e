//! `ihd-fleet status`.

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use ihd::cli::global::Global;
use ihd::report::table::TextTable;
use ihd::{ensure_usage, say};
use ihd_fleet::jetstream::SILENT_AFTER;
use ihd_fleet::{claims, names, status};
use ihd_model::{FleetDevice, FleetEdge, FleetReport, FleetWorker};
use serde::Serialize;

use super::dead::DeadWindowArgs;
use super::{AccessArgs, StatusCheckFailed, ago};

/// State of the fleet, with the edges that are missing in it.
#[derive(Serialize)]
struct FleetStatus {
    #[serde(flatten)]
    report: FleetReport,
    /// Edges that have a name in the fleet, and were not heard of; `None` if the names cannot be read.
    silent_edges: Option<Vec<String>>,
    /// Reason for which they cannot be read, as with another key than the operator's.
    #[serde(skip)]
    names_unread: Option<String>,
}

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
    /// With fleet: end with code 7 where windows are dead, no worker is there for a backlog, an edge or a hob was not heard of for 30 s, or an
    /// edge has an alarm: windows that are due for 10 min or without an answer for an hour, a name that is another store's, a part that
    /// fails for 10 min
    #[arg(long)]
    check: bool,
    /// With devices: only those whose firmware differs from that of most of their board, or from `ihd-fleet init --build`
    #[arg(long)]
    outdated: bool,
    #[command(flatten)]
    which: DeadWindowArgs,
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

fn read(access: &AccessArgs, global: &Global) -> Result<FleetStatus> {
    access.with(global, async |access, context| {
        let report = status::report(&context, &access.shown()).await?;
        let claimed = claims::edges(&context).await;
        Ok(FleetStatus::new(report, claimed.map_err(|e| e.to_string())))
    })
}

impl FleetStatus {
    /// Creates it from the report and the names that edges have claimed.
    fn new(report: FleetReport, claimed: Result<Vec<String>, String>) -> Self {
        let is_silent = |name: &String| !report.edges.iter().any(|edge| edge.name == *name);
        let (claimed, names_unread) = match claimed {
            Ok(names) => (Some(names), None),
            Err(why) => (None, Some(why)),
        };
        Self {
            silent_edges: claimed.map(|names| names.into_iter().filter(is_silent).collect()),
            names_unread,
            report,
        }
    }
}

/// Returns `true` if no edge has renewed the card of a hob.
fn is_silent(device: &FleetDevice, at_ms: i64) -> bool {
    let silence_ms = i64::try_from(SILENT_AFTER.as_millis()).unwrap_or(i64::MAX);
    at_ms.saturating_sub(device.last_seen_ms) > silence_ms
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
        let status = read(access, global)?;
        match global.json {
            true => say!("{}", serde_json::to_string_pretty(&status)?)?,
            false => say!("{}", report_text(&status).trim_end())?,
        }
        match describe_problem(&status) {
            Some(why) if self.check => Err(StatusCheckFailed(why).into()),
            _ => Ok(()),
        }
    }
}

/// Returns all that needs somebody; `None` if nothing does.
fn describe_problem(status: &FleetStatus) -> Option<String> {
    let report = &status.report;
    let mut reasons: Vec<String> = silences(status).chain(alarms(report)).collect();
    if let Some(why) = &status.names_unread {
        reasons.push(format!(
            "a dead edge would not be seen, as the names of edges cannot be read, which takes the operator's key: {why}"
        ));
    }
    if report.dead > 0 {
        let dead = report.dead;
        reasons.push(format!(
            "{dead} windows were given up: ihd-fleet status dead"
        ));
    }
    if report.backlog > 0 && report.workers.is_empty() {
        let backlog = report.backlog;
        reasons.push(format!(
            "{backlog} windows wait, and there is no worker: ihd-fleet worker"
        ));
    }
    (!reasons.is_empty()).then(|| reasons.join("; "))
}

/// Edges and hobs that were not heard of.
fn silences(status: &FleetStatus) -> impl Iterator<Item = String> {
    let edge = |name: &String| {
        format!(
            "edge {name} was not heard of for {} s: is its daemon running? `ihd-fleet init --free {name}` where it is gone for good",
            SILENT_AFTER.as_secs()
        )
    };
    let hob = |device: &FleetDevice| {
        let (name, edge, since) = (&device.name, &device.edge, ago(device.last_seen_ms));
        format!("hob {name} of edge {edge} was not heard of for {since}")
    };
    let at_ms = status.report.at_ms;
    let hobs = status.report.devices.iter();
    let hobs = hobs.filter(move |device| is_silent(device, at_ms)).map(hob);
    status.silent_edges.iter().flatten().map(edge).chain(hobs)
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

fn report_text(status: &FleetStatus) -> String {
    let report = &status.report;
    let mut text = format!(
        "{}: {} windows ever, {} results, {} in the backlog, {} dead\n",
        report.server, report.windows, report.results, report.backlog, report.dead
    );
    match report.workers.is_empty() {
        true => text.push_str("no worker: ihd-fleet worker\n"),
        false => text.push_str(&format!("\n{}", workers(&report.workers).render())),
    }
    if !report.edges.is_empty() {
        text.push_str(&format!("\n{}", edges(&report.edges).render()));
    }
    for line in silences(status).chain(alarms(report)) {
        text.push_str(&format!("{line}\n"));
    }
    text.push_str(&format!(
        "\n{} hobs, {} of them outdated: ihd-fleet status devices",
        report.devices.len(),
        report.devices.iter().filter(|d| d.outdated).count()
    ));
    text
}

/// One row per worker.
fn workers(workers: &[FleetWorker]) -> TextTable {
    let mut table = TextTable::new(&["worker", "threads", "at", "done", "failed", "ihd", "seen"]);
    for worker in workers {
        table.row([
            worker.name.clone(),
            worker.threads.to_string(),
            worker.busy.to_string(),
            worker.done.to_string(),
            worker.failed.to_string(),
            worker.version.clone(),
            ago(worker.last_seen_ms),
        ]);
    }
    table
}

/// One row per edge.
fn edges(edges: &[FleetEdge]) -> TextTable {
    let mut table = TextTable::new(&[
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
    for edge in edges {
        let states = &edge.states;
        let learns = if edge.delegates { "fleet" } else { "itself" };
        table.row([
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
    table
}

impl StatusArgs {
    fn devices(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let mut report = read(access, global)?.report;
        report.devices.retain(|d| d.outdated || !self.outdated);
        if global.json {
            return say!("{}", serde_json::to_string_pretty(&report.devices)?);
        }
        let mut table = TextTable::new(&[
            "hob", "edge", "state", "pot", "firmware", "", "protocol", "lookup", "seen",
        ]);
        for device in &report.devices {
            let outdated = if device.outdated { "outdated" } else { "" };
            let state = match is_silent(device, report.at_ms) {
                true => format!("silent (was {})", device.state),
                false => device.state.clone(),
            };
            table.row([
                device.name.clone(),
                device.edge.clone(),
                state,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_whose_card_has_expired_and_its_hobs_are_amiss() {
        let hob = |name: &str, last_seen_ms| FleetDevice {
            name: name.into(),
            edge: "lab-1".into(),
            last_seen_ms,
            ..FleetDevice::default()
        };
        let edge = |name: &str| FleetEdge {
            name: name.into(),
            ..FleetEdge::default()
        };
        let status = |edges: &[&str], age_ms: i64| {
            let report = FleetReport {
                at_ms: 1_000_000,
                edges: edges.iter().map(|name| edge(name)).collect(),
                devices: vec![hob("bench", 1_000_000 - age_ms)],
                ..FleetReport::default()
            };
            let claimed = vec!["lab-1".to_owned(), "lab-2".to_owned()];
            describe_problem(&FleetStatus::new(report, Ok(claimed)))
        };
        assert_eq!(status(&["lab-1", "lab-2"], 30_000), None);
        let why = status(&["lab-2", "lab-1.refused"], 30_000).unwrap();
        assert!(
            why.contains("edge lab-1 ") && !why.contains("lab-2"),
            "{why}"
        );
        let why = status(&["lab-1", "lab-2"], 30_001).unwrap();
        assert!(why.contains("hob bench of edge lab-1"), "{why}");
        // A key that may not list the names never says that all is well.
        assert!(
            describe_problem(&FleetStatus::new(
                FleetReport::default(),
                Err("denied".into())
            ))
            .is_some()
        );
    }
}
