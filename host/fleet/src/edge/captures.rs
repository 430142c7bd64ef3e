//! Finished recordings of an edge, uploaded to the fleet's object store.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;

use super::link::Link;
use crate::captures;
use crate::jetstream::JetStreamError;
use crate::names;

/// Period of the search for a finished recording.
const POLL_PERIOD: Duration = Duration::from_secs(10);

/// Uploads each finished recording once, as `EDGE/FILE`, until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    let mut there = None;
    while link
        .turn(
            "captures",
            POLL_PERIOD,
            take_turn(&link, &context, &mut there),
        )
        .await
    {}
}

/// Uploads the recordings that are not `there`, once the fleet's are known; returns the pause before the next search.
async fn take_turn(
    link: &Link,
    context: &Context,
    there: &mut Option<BTreeSet<String>>,
) -> Result<Duration, JetStreamError> {
    if link.is_admitted() {
        let there = match there {
            Some(there) => there,
            None => {
                let listed = captures::list(context).await?;
                there.insert(listed.into_iter().map(|c| c.name).collect())
            }
        };
        upload_new(link, context, there).await?;
        link.works("captures");
    }
    Ok(POLL_PERIOD)
}

async fn upload_new(
    link: &Link,
    context: &Context,
    there: &mut BTreeSet<String>,
) -> Result<(), JetStreamError> {
    let recordings = link
        .daemon
        .recordings()
        .list()
        .await
        .map_err(|e| JetStreamError::new(names::CAPTURES, e))?;
    for recording in recordings.into_iter().filter(|r| !r.under_way) {
        let name = format!("{}/{}", link.edge, recording.file);
        if there.contains(&name) {
            continue;
        }
        let path = link.daemon.recordings().folder().join(&recording.file);
        let bytes = captures::put(context, &path, &name).await?;
        tracing::info!(name, bytes, "a recording is in the fleet");
        there.insert(name);
    }
    Ok(())
}
