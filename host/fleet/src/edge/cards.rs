//! What the fleet knows of this edge and its hobs, and what this edge knows of the fleet.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use ihd_daemon::learning::WorkerFigures;
use ihd_daemon::model::{
    DeviceReport, FleetAnswers, FleetDevice, FleetEdge, FleetReport, FleetStates,
};
use tokio::time::Instant;

use super::alarms::Alarms;
use super::{Link, now_ms};
use crate::claims::Standing;
use crate::engine::{self, EngineError, SILENT_AFTER};
use crate::names;
use crate::status::{self, HobCard};

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// How often the whole fleet is looked at: a thousand hobs are as many small answers.
const REPORT_EVERY: Duration = Duration::from_secs(10);

/// Time between two counts of this edge's own windows.
const COUNT_EVERY: Duration = Duration::from_secs(5);

/// How often a card is renewed that says nothing new.
const RENEW_EVERY: Duration = Duration::from_secs(SILENT_AFTER.as_secs() / 3);

/// Cards that the fleet has, and since when.
#[derive(Default)]
struct Told {
    hobs: BTreeMap<String, (HobCard, Instant)>,
    edge: Option<(FleetEdge, Instant)>,
}

/// Tells until the edge ends.
pub async fn run(link: Arc<Link>, context: Context) {
    let mut told = Told::default();
    let mut report = FleetReport::default();
    let mut reported: Option<Instant> = None;
    let mut own = Own::default();
    // Why not all of the fleet is seen.
    let mut partly = String::new();
    loop {
        own.look(&link).await;
        if link.reaches() {
            match tell(&link, &context, &mut told, &own).await {
                Ok(()) => link.works("cards"),
                Err(why) => link.failed("cards", &why),
            }
            if reported.is_none_or(|at| at.elapsed() >= REPORT_EVERY) {
                reported = Some(Instant::now());
                (report, partly) = look(&link, &context, report).await;
            }
        } else {
            told = Told::default();
            reported = None;
        }
        report.server.clone_from(&link.address);
        report.edge.clone_from(&link.edge);
        report.connected = link.state().connected;
        report.outbox = own.states.due;
        report.states = own.states;
        report.alarms.clone_from(&own.alarms);
        report.answers = own.answers;
        let why = link.why();
        report.why = if why.is_empty() { partly.clone() } else { why };
        link.daemon.tell_fleet(report.clone());
        if !link.wait(LOOK_EVERY).await {
            return;
        }
    }
}

/// This edge's own windows, and what they need.
#[derive(Default)]
struct Own {
    states: FleetStates,
    alarms: Vec<String>,
    answers: FleetAnswers,
    late: Alarms,
    counted: Option<Instant>,
}

impl Own {
    async fn look(&mut self, link: &Link) {
        if self.counted.is_none_or(|at| at.elapsed() >= COUNT_EVERY) {
            self.counted = Some(Instant::now());
            match link.daemon.fleet_tally().await {
                Ok(tally) => self.states = tally.into(),
                Err(why) => link.failed("store", &why),
            }
        }
        self.alarms = self.late.look(&self.states, now_ms());
        let workers = link.daemon.workers();
        self.answers = FleetAnswers::of(workers.values());
        self.alarms.extend(workers.iter().filter_map(caught));
        if let Standing::Refused(why) = &link.state().standing {
            self.alarms.insert(0, why.clone());
        }
    }
}

/// Names a worker whose answers were refuted, with what; none for the others.
fn caught((name, figures): (&String, &WorkerFigures)) -> Option<String> {
    let WorkerFigures { refuted, why, .. } = figures;
    let beyond = match figures.is_distrusted() {
        true => ", and nothing of it is looked at any more",
        false => "",
    };
    (*refuted > 0)
        .then(|| format!("{refuted} answers of worker {name} were refuted{beyond}: {why}"))
}

/// The whole fleet, where this edge's key may look at it; else its own hobs, and why.
async fn look(link: &Link, context: &Context, before: FleetReport) -> (FleetReport, String) {
    match status::report(context, &link.address).await {
        Ok(report) => (report, String::new()),
        Err(why) => own_hobs(link, before, &why),
    }
}

fn own_hobs(link: &Link, before: FleetReport, why: &EngineError) -> (FleetReport, String) {
    let report = FleetReport {
        at_ms: now_ms(),
        devices: link
            .daemon
            .devices()
            .iter()
            .map(|d| card(link, d).device)
            .collect(),
        ..before
    };
    (report, format!("only this edge's hobs are shown: {why}"))
}

/// Tells of the edge and its hobs; where its name is another one's, of that alone.
async fn tell(
    link: &Link,
    context: &Context,
    told: &mut Told,
    own: &Own,
) -> Result<(), EngineError> {
    let is_due = |since: Option<Instant>| since.is_none_or(|at| at.elapsed() >= RENEW_EVERY);
    let standing = link.state().standing.clone();
    let key = match standing {
        Standing::Unknown => return Ok(()),
        Standing::Held => link.edge.clone(),
        Standing::Refused(_) => names::refused_edge(&link.edge),
    };
    let mine = FleetEdge {
        name: link.edge.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        outbox: own.states.due,
        trusts_fleet: link.daemon.trusts_fleet(),
        states: own.states,
        alarms: own.alarms.clone(),
        last_seen_ms: now_ms(),
    };
    let is_news = |(before, at): &(FleetEdge, Instant)| {
        (before.trusts_fleet, &before.alarms) != (mine.trusts_fleet, &mine.alarms)
            || is_due(Some(*at))
    };
    if told.edge.as_ref().is_none_or(is_news) {
        put(context, names::EDGES, &key, &mine).await?;
        told.edge = Some((mine, Instant::now()));
    }
    if standing != Standing::Held {
        return Ok(());
    }
    for device in link.daemon.devices() {
        if !ihd_daemon::config::is_name(&device.name) {
            continue;
        }
        let card = card(link, &device);
        let known = told.hobs.get(&device.name);
        if known.is_some_and(|(before, since)| same(before, &card) && !is_due(Some(*since))) {
            continue;
        }
        put(context, names::HOBS, &device.name, &card).await?;
        told.hobs.insert(device.name, (card, Instant::now()));
    }
    Ok(())
}

fn same(a: &HobCard, b: &HobCard) -> bool {
    let timeless = |card: &HobCard| FleetDevice {
        last_seen_ms: 0,
        ..card.device.clone()
    };
    a.board == b.board && timeless(a) == timeless(b)
}

fn card(link: &Link, device: &DeviceReport) -> HobCard {
    let identity = device.identity.as_ref();
    HobCard {
        board: identity.map_or(String::new(), |i| i.board.clone()),
        device: FleetDevice {
            name: device.name.clone(),
            edge: link.edge.clone(),
            state: device.state.word().to_owned(),
            pot: device
                .live
                .as_ref()
                .map_or(String::new(), |l| l.pot.clone()),
            build: identity.map_or(String::new(), |i| i.build.clone()),
            protocol: identity.map_or((0, 0), |i| i.protocol),
            lookup_version: device.lookup.on_device.unwrap_or(0),
            outdated: false,
            last_seen_ms: now_ms(),
        },
    }
}

async fn put<T: serde::Serialize>(
    context: &Context,
    bucket: &str,
    key: &str,
    card: &T,
) -> Result<(), EngineError> {
    let card = serde_json::to_vec(card).map_err(|e| EngineError::new(bucket, e))?;
    engine::put(context, bucket, key, card).await
}
