//! What the fleet knows of this edge and its hobs, and what this edge knows of the fleet.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use async_nats::jetstream::Context;
use ihd_daemon::model::{DeviceReport, FleetDevice, FleetEdge, FleetReport};

use super::{Link, now_ms};
use crate::engine::{self, EngineError, SILENT_AFTER};
use crate::names;
use crate::status::{self, HobCard};

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// How often the whole fleet is looked at: a thousand hobs are as many small answers.
const REPORT_EVERY: Duration = Duration::from_secs(10);

/// How often a card is renewed that says nothing new.
const RENEW_EVERY: Duration = Duration::from_secs(SILENT_AFTER.as_secs() / 3);

/// Cards that the fleet has, and since when.
#[derive(Default)]
struct Told {
    hobs: BTreeMap<String, (HobCard, Instant)>,
    edge: Option<Instant>,
}

/// Tells until the edge ends.
pub async fn run(link: Arc<Link>) {
    let mut told = Told::default();
    let mut report = FleetReport::default();
    let mut reported: Option<Instant> = None;
    loop {
        // A store that cannot count is told by its own thread.
        let outbox = link.daemon.count_due().await.unwrap_or(report.outbox);
        let (connected, why) = {
            let state = link.state();
            (state.connected, state.why.clone())
        };
        if connected && link.serves() {
            if let Err(why) = tell(&link, &mut told, outbox).await {
                link.failed("cards", &why);
            }
            if reported.is_none_or(|at| at.elapsed() >= REPORT_EVERY) {
                reported = Some(Instant::now());
                report = look(&link, report).await;
            }
        } else {
            told = Told::default();
            reported = None;
        }
        report.server.clone_from(&link.server);
        report.edge.clone_from(&link.edge);
        report.connected = connected;
        report.outbox = outbox;
        if !connected || report.why.is_empty() {
            report.why = why;
        }
        link.daemon.tell_fleet(report.clone());
        if !link.wait(LOOK_EVERY).await {
            return;
        }
    }
}

/// The whole fleet, where this edge's key may look at it; else its own hobs.
async fn look(link: &Link, before: FleetReport) -> FleetReport {
    match status::report(&link.context, &link.server).await {
        Ok(report) => report,
        Err(why) => FleetReport {
            why: format!("only this edge's hobs are shown: {why}"),
            at_ms: now_ms(),
            devices: link
                .daemon
                .devices()
                .iter()
                .map(|d| card(link, d).device)
                .collect(),
            ..before
        },
    }
}

async fn tell(link: &Link, told: &mut Told, outbox: u64) -> Result<(), EngineError> {
    let is_due = |since: Option<Instant>| since.is_none_or(|at| at.elapsed() >= RENEW_EVERY);
    if is_due(told.edge) {
        let card = FleetEdge {
            name: link.edge.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            outbox,
            trusts_fleet: link.daemon.trusts_fleet(),
            last_seen_ms: now_ms(),
        };
        put(&link.context, names::EDGES, &link.edge, &card).await?;
        told.edge = Some(Instant::now());
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
        put(&link.context, names::HOBS, &device.name, &card).await?;
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
