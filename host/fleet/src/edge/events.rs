//! Events of the store to the fleet, in order. If the edge is killed between the publication of an event and its note, the event is sent
//! twice, with the same number.

use std::sync::Arc;
use std::time::Duration;

use ihd_store::EventRow;
use serde::{Deserialize, Serialize};

use super::link::{Link, RETRY_PAUSE};
use crate::names;
use crate::stream_message::{Outgoing, PendingAck};

/// Events sent at once.
const BATCH: usize = 128;

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
    while link.turn("events", RETRY_PAUSE, take_turn(&link)).await {}
}

/// Sends a batch; returns the pause before the next one.
async fn take_turn(link: &Link) -> Result<Duration, String> {
    if !link.is_admitted() {
        return Ok(POLL_PERIOD);
    }
    let sent = send_batch(link).await?;
    link.works("events");
    Ok(match sent {
        BATCH => Duration::ZERO,
        _ => POLL_PERIOD,
    })
}

async fn send_batch(link: &Link) -> Result<usize, String> {
    let due = link.daemon.fleet().due_events(BATCH).await;
    let due = due.map_err(|e| e.to_string())?;
    let count = due.len();
    let (hobs, mut under_way) = (link.hobs(), Vec::new());
    for (number, event) in due {
        under_way.push((number, send(link, &hobs, number, event).await?));
    }
    let mut up_to = None;
    let mut failed = None;
    for (number, acknowledged) in under_way {
        let sent = match acknowledged {
            Some(sent) => sent.await.map(drop),
            None => Ok(()),
        };
        match sent {
            Ok(()) => up_to = Some(number),
            // Later events are sent again.
            Err(why) => {
                failed = Some(why.to_string());
                break;
            }
        }
    }
    if let Some(up_to) = up_to {
        let noted = link.daemon.fleet().mark_events_sent(up_to).await;
        noted.map_err(|e| e.to_string())?;
    }
    failed.map_or(Ok(count), Err)
}

/// Publishes an event; `None` if it is of none of these hobs. An edge may publish nothing of a hob that it has no more.
async fn send(
    link: &Link,
    hobs: &[String],
    number: i64,
    event: EventRow,
) -> Result<Option<PendingAck>, String> {
    let Some(hob) = event.device.filter(|hob| hobs.contains(hob)) else {
        return Ok(None);
    };
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
        number: Some(format!("{}-event-{number}", link.edge)),
        after: None,
    };
    let sent = link.server.publish(message).await;
    sent.map(Some).map_err(|e| e.to_string())
}
