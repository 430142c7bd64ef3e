//! Finished recordings of an edge, uploaded to the fleet's object store.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;
use tokio::time::Instant;

use super::link::Link;
use crate::captures;
use crate::jetstream::JetStreamError;
use crate::names;

/// Part of which failures are recorded.
const PART: &str = "captures";

/// Longest pause before a recording is tried again.
const MAX_PAUSE: Duration = Duration::from_secs(3_600);

/// Recordings that failed: time of the next try, and the pause before it.
type Paused = BTreeMap<String, (Instant, Duration)>;

/// Period of the search for a finished recording.
const POLL_PERIOD: Duration = Duration::from_secs(10);

/// Time for which the list of the fleet's recordings counts: a server that lost its disk gets them again.
const LIST_VALID: Duration = Duration::from_secs(3_600);

/// Names of the fleet's recordings, and the time at which they were listed.
type Listed = (BTreeSet<String>, Instant);

/// Uploads each finished recording once, as `EDGE/FILE`, until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    let (mut listed, mut paused) = (None, Paused::new());
    loop {
        let turn = take_turn(&link, &context, &mut listed, &mut paused);
        if !link.turn(PART, POLL_PERIOD, turn).await {
            return;
        }
    }
}

/// Uploads the recordings that the fleet lacks; returns the pause before the next search.
async fn take_turn(
    link: &Link,
    context: &Context,
    listed: &mut Option<Listed>,
    paused: &mut Paused,
) -> Result<Duration, JetStreamError> {
    if link.is_admitted() {
        let there = match listed {
            Some((there, at)) if at.elapsed() < LIST_VALID => there,
            _ => {
                let names = captures::list(context).await?.into_iter().map(|c| c.name);
                &mut listed.insert((names.collect(), Instant::now())).0
            }
        };
        upload_new(link, context, there, paused).await?;
        if paused.is_empty() {
            link.works(PART);
        }
    }
    Ok(POLL_PERIOD)
}

async fn upload_new(
    link: &Link,
    context: &Context,
    there: &mut BTreeSet<String>,
    paused: &mut Paused,
) -> Result<(), JetStreamError> {
    let recordings = link
        .daemon
        .recordings()
        .list()
        .await
        .map_err(|e| JetStreamError::new(names::CAPTURES, e))?;
    let names = recordings
        .iter()
        .map(|r| format!("{}/{}", link.edge, r.file));
    let names: BTreeSet<String> = names.collect();
    paused.retain(|name, _| names.contains(name));
    for recording in recordings.into_iter().filter(|r| !r.under_way) {
        let name = format!("{}/{}", link.edge, recording.file);
        if there.contains(&name) {
            continue;
        }
        if paused
            .get(&name)
            .is_some_and(|(until, _)| Instant::now() < *until)
        {
            continue;
        }
        let path = link.daemon.recordings().folder().join(&recording.file);
        match captures::put(context, &path, &name).await {
            Ok(bytes) => {
                tracing::info!(name, bytes, "a recording is in the fleet");
                paused.remove(&name);
                there.insert(name);
            }
            // The others are not held up.
            Err(why) => {
                let why = format!("{name}: {}", why.why);
                link.failed(PART, &why);
                let before = paused.get(&name).map_or(POLL_PERIOD, |(_, pause)| *pause);
                let pause = (2 * before).min(MAX_PAUSE);
                paused.insert(name, (Instant::now() + pause, pause));
            }
        }
    }
    Ok(())
}
