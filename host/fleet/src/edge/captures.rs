//! Finished recordings of an edge, uploaded to the fleet's object store.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Context;

use super::Link;
use crate::captures;
use crate::jetstream::JetStreamError;
use crate::names;

/// Period of the search for a finished recording.
const POLL_PERIOD: Duration = Duration::from_secs(10);

/// Uploads each finished recording once, as `EDGE/FILE`, until the edge stops.
pub async fn run(link: Arc<Link>, context: Context) {
    let mut there: BTreeSet<String> = BTreeSet::new();
    let mut known = false;
    loop {
        if link.is_admitted() {
            if !known {
                let listed = captures::list(&context).await;
                known = listed.is_ok();
                there.extend(listed.unwrap_or_default().into_iter().map(|c| c.name));
            }
            if known {
                match upload_new(&link, &context, &mut there).await {
                    Ok(()) => link.works("captures"),
                    Err(why) => link.failed("captures", &why),
                }
            }
        }
        if !link.wait(POLL_PERIOD).await {
            return;
        }
    }
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
