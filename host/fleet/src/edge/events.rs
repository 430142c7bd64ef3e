//! Events of the store to the fleet, those of each hob in order. If the edge is killed between the publication of an event and its note, the event is sent
//! twice, with the same number.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use ihd_store::EventRow;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;

use super::link::Link;
use super::refusals::RETRY_PAUSE;
use crate::message_ids::MessageIds;
use crate::names;
use crate::stream_message::{Outgoing, PendingAck, PublishFailure};

/// Events sent at once.
const BATCH: usize = 128;

/// Part of which failures are recorded.
const PART: &str = "events";

/// Period of polling the store.
const POLL_PERIOD: Duration = Duration::from_secs(2);

/// Event (JSON).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventMessage {
    /// Name of the edge.
    pub edge: String,
    /// Number in the edge's store.
    pub number: i64,
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Kind of the event (docs/daemon.md).
    pub kind: String,
    /// Description.
    pub text: String,
}

/// Sends until the edge stops. Events of the daemon itself, and of hobs that it has no more, stay in its store.
pub async fn run(link: Arc<Link>) {
    while link.turn(PART, RETRY_PAUSE, take_turn(&link)).await {}
}

/// Sends a batch; returns the pause before the next one.
async fn take_turn(link: &Link) -> Result<Duration, String> {
    if !link.is_admitted() {
        return Ok(POLL_PERIOD);
    }
    let sent = send_batch(link).await?;
    link.works(PART);
    Ok(match sent {
        BATCH => Duration::ZERO,
        _ => POLL_PERIOD,
    })
}

async fn send_batch(link: &Link) -> Result<usize, String> {
    let began = Instant::now();
    let secret = link.daemon.fleet().secret().await;
    let message_ids = MessageIds::new(secret.map_err(|e| e.to_string())?);
    let hobs = link.hobs_to_try(PART);
    let due = link.daemon.fleet().due_events(hobs.clone(), BATCH).await;
    let (due, up_to) = due.map_err(|e| e.to_string())?;
    let count = due.len();
    let (mut under_way, mut refused) = (Vec::new(), BTreeSet::new());
    for (number, event) in due {
        let Some(hob) = event.device.clone().filter(|hob| !refused.contains(hob)) else {
            continue;
        };
        match send(link, &message_ids, &hob, number, event).await? {
            Ok(sent) => under_way.push((hob, number, sent)),
            Err(why) => {
                link.refused(PART, &hob, &why, began);
                refused.insert(hob);
            }
        }
    }
    let mut sent: BTreeMap<String, i64> = BTreeMap::new();
    for (hob, number, acknowledged) in under_way {
        match acknowledged.await {
            _ if refused.contains(&hob) => {}
            Ok(_) => {
                sent.insert(hob, number);
            }
            // Later events of this hob are sent again.
            Err(why) => {
                link.refused(PART, &hob, &why, began);
                refused.insert(hob);
            }
        }
    }
    for hob in sent.keys().filter(|hob| !refused.contains(*hob)) {
        link.accepted(PART, hob);
    }
    let is_all = refused.is_empty() && hobs == link.hobs();
    let noted = link.daemon.fleet();
    let noted = noted.mark_events_sent(sent.into_iter().collect(), is_all.then_some(up_to));
    noted.await.map_err(|e| e.to_string())?;
    Ok(if refused.is_empty() { count } else { 0 })
}

/// Publishes an event of a hob.
async fn send(
    link: &Link,
    message_ids: &MessageIds,
    hob: &str,
    number: i64,
    event: EventRow,
) -> Result<Result<PendingAck, PublishFailure>, String> {
    let message = EventMessage {
        edge: link.edge.clone(),
        number,
        at_ms: event.at_ms,
        kind: event.kind,
        text: event.text,
    };
    let payload = serde_json::to_vec(&message).map_err(|e| e.to_string())?;
    let message = Outgoing {
        subject: names::event(hob),
        payload: payload.into(),
        number: Some(message_ids.event_id(&link.edge, number, event.at_ms)),
        after: None,
    };
    Ok(link.server.publish(message).await)
}
