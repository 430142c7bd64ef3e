//! Cards of this edge and its hobs for the fleet, and the report of the fleet for the daemon.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use ihd_daemon::learning::{WorkerFigures, sum_answers};
use ihd_model::{DeviceReport, FleetAnswers, FleetDevice, FleetEdge, FleetReport, FleetStates};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::alarms::Alarms;
use super::link::{Link, STORE};
use crate::clock::now_ms;
use crate::jetstream::{self, JetStreamError, SILENT_AFTER};
use crate::names;
use crate::standing::Standing;
use crate::status::{self, HobCard};

/// Part of which failures are recorded.
const PART: &str = "cards";

/// Period of updates.
const UPDATE_PERIOD: Duration = Duration::from_secs(2);

/// Period of reading the whole fleet.
const REPORT_PERIOD: Duration = Duration::from_secs(10);

/// Longest time that reading the fleet may take.
const REPORT_TIMEOUT: Duration = Duration::from_secs(30);

/// Period of counting this edge's windows.
const COUNT_PERIOD: Duration = Duration::from_secs(5);

/// Period of renewing an unchanged card.
const RENEWAL_PERIOD: Duration = Duration::from_secs(SILENT_AFTER.as_secs() / 3);

/// Published cards, each with its time.
#[derive(Default)]
struct PublishedCards {
    hobs: BTreeMap<String, (HobCard, Instant)>,
    edge: Option<(FleetEdge, Instant)>,
}

/// Publishes and reports until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    let mut published = PublishedCards::default();
    let mut report = FleetReport::default();
    let mut reported: Option<Instant> = None;
    let mut own = OwnWindows::default();
    // Reason for which only a part of the fleet is reported.
    let mut partly = String::new();
    // Apart: a far server delays no card. Dropped with it, it ends.
    let mut reading = JoinSet::new();
    loop {
        own.update(&link).await;
        if link.is_reachable() {
            match publish_cards(&link, &context, &mut published, &own).await {
                Ok(()) => link.works(PART),
                Err(why) => link.failed(PART, &why),
            }
            match reading.try_join_next() {
                Some(Ok(Ok(read))) => (report, partly) = (read, String::new()),
                Some(Ok(Err(why))) => (report, partly) = own_hobs(&link, report, &why),
                Some(Err(_)) | None => {}
            }
            if reading.is_empty() && reported.is_none_or(|at| at.elapsed() >= REPORT_PERIOD) {
                reported = Some(Instant::now());
                reading.spawn(fleet_report(link.address.clone(), context.clone()));
            }
        } else {
            published = PublishedCards::default();
            reported = None;
            reading.abort_all();
        }
        report.server.clone_from(&link.address);
        report.edge.clone_from(&link.edge);
        report.connected = link.state().connected;
        report.outbox = own.states.due;
        report.states = own.states;
        report.alarms.clone_from(&own.alarms);
        report.answers = own.answers;
        let why = link.failure_text();
        report.why = if why.is_empty() { partly.clone() } else { why };
        link.daemon.fleet().set_report(report.clone());
        if !link.wait(UPDATE_PERIOD).await {
            return;
        }
    }
}

/// Counts and alarms of this edge's windows.
#[derive(Default)]
struct OwnWindows {
    states: FleetStates,
    alarms: Vec<String>,
    answers: FleetAnswers,
    late: Alarms,
    counted: Option<Instant>,
}

impl OwnWindows {
    async fn update(&mut self, link: &Link) {
        if self.counted.is_none_or(|at| at.elapsed() >= COUNT_PERIOD) {
            self.counted = Some(Instant::now());
            match link.daemon.fleet().tally().await {
                Ok(states) => {
                    self.states = states;
                    link.works(STORE);
                }
                Err(why) => link.failed(STORE, &why),
            }
        }
        self.alarms = link.alarms();
        self.alarms.extend(self.late.update(&self.states, now_ms()));
        let workers = link.daemon.fleet().workers();
        self.answers = sum_answers(workers.values());
        self.alarms
            .extend(workers.iter().filter_map(refutation_alarm));
        if let Standing::Refused(why) = &link.state().standing {
            self.alarms.insert(0, why.clone());
        }
    }
}

/// Returns the alarm of a worker with refuted answers, `None` for other workers.
fn refutation_alarm((name, figures): (&String, &WorkerFigures)) -> Option<String> {
    let WorkerFigures { refuted, why, .. } = figures;
    let beyond = match figures.is_distrusted() {
        true => ", and nothing of it is looked at any more",
        false => "",
    };
    (*refuted > 0)
        .then(|| format!("{refuted} answers of worker {name} were refuted{beyond}: {why}"))
}

/// Reads the report of the whole fleet.
async fn fleet_report(address: String, context: Context) -> Result<FleetReport, JetStreamError> {
    let reading = status::report(&context, &address);
    match tokio::time::timeout(REPORT_TIMEOUT, reading).await {
        Ok(report) => report,
        Err(_) => {
            let why = format!("not read within {} s", REPORT_TIMEOUT.as_secs());
            Err(JetStreamError::new("the fleet", why))
        }
    }
}

/// Returns the report with the present state of this edge's hobs alone, and the reason: its key may not read the fleet, or that failed. Numbers
/// and their time stay those last read.
fn own_hobs(link: &Link, before: FleetReport, why: &JetStreamError) -> (FleetReport, String) {
    let report = FleetReport {
        devices: link
            .daemon
            .view()
            .devices()
            .iter()
            .map(|d| card(link, d).device)
            .collect(),
        ..before
    };
    (report, format!("only this edge's hobs are shown: {why}"))
}

/// Publishes the cards of the edge and its hobs; only the edge's refusal if its name is another store's.
async fn publish_cards(
    link: &Link,
    context: &Context,
    published: &mut PublishedCards,
    own: &OwnWindows,
) -> Result<(), JetStreamError> {
    let began = Instant::now();
    let is_due = |since: Option<Instant>| since.is_none_or(|at| at.elapsed() >= RENEWAL_PERIOD);
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
        delegates: link.daemon.fleet().is_delegated(),
        states: own.states,
        alarms: own.alarms.clone(),
        last_seen_ms: now_ms(),
    };
    let is_changed = |(before, at): &(FleetEdge, Instant)| {
        (before.delegates, &before.alarms) != (mine.delegates, &mine.alarms) || is_due(Some(*at))
    };
    if published.edge.as_ref().is_none_or(is_changed) {
        put(context, names::EDGES, &key, &mine).await?;
        link.state().refusals.served(PART, Instant::now());
        published.edge = Some((mine, Instant::now()));
    }
    if standing != Standing::Held {
        return Ok(());
    }
    for device in link.daemon.view().devices() {
        if !ihd_daemon::config::is_name(&device.name) {
            continue;
        }
        let card = card(link, &device);
        let known = published.hobs.get(&device.name);
        if known.is_some_and(|(before, since)| is_unchanged(before, &card) && !is_due(Some(*since)))
        {
            continue;
        }
        if !link.may_try(PART, &device.name) {
            continue;
        }
        if let Err(why) = put(context, names::HOBS, &device.name, &card).await {
            link.refused(PART, &device.name, &why, began);
            continue;
        }
        link.accepted(PART, &device.name);
        published.hobs.insert(device.name, (card, Instant::now()));
    }
    Ok(())
}

fn is_unchanged(a: &HobCard, b: &HobCard) -> bool {
    let without_time = |card: &HobCard| FleetDevice {
        last_seen_ms: 0,
        ..card.device.clone()
    };
    a.board == b.board && without_time(a) == without_time(b)
}

fn card(link: &Link, device: &DeviceReport) -> HobCard {
    let identity = device.identity.as_ref();
    HobCard {
        board: identity.map_or(String::new(), |i| i.board.clone()),
        device: FleetDevice {
            name: device.name.clone(),
            edge: link.edge.clone(),
            state: device.state.as_str().to_owned(),
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
) -> Result<(), JetStreamError> {
    let card = serde_json::to_vec(card).map_err(|e| JetStreamError::new(bucket, e))?;
    jetstream::put(context, bucket, key, card).await
}
