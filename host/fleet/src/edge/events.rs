//! Events of the store to the fleet, in their order. An event that the fleet has got and the edge was killed before it noted that comes
//! twice, with one number.

use std::sync::Arc;
use std::time::Duration;

use ihd_store::EventRow;
use serde::{Deserialize, Serialize};

use super::{Link, TRY_AGAIN};
use crate::names;
use crate::server::{Outgoing, UnderWay};

/// Events under way at once.
const BATCH: usize = 128;

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// Something that happened, as it travels (JSON).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventMessage {
    /// The edge that tells it.
    pub edge: String,
    /// Its number in the edge's store.
    pub number: i64,
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// A word for its kind (docs/store.md).
    pub kind: String,
    /// What.
    pub text: String,
}

/// Sends until the edge ends. What the daemon itself tells, of no device, stays in its store.
pub async fn run(link: Arc<Link>) {
    loop {
        let pause = match link.is_admitted() {
            true => match send_some(&link).await {
                Ok(sent) => {
                    link.works("events");
                    if sent == BATCH {
                        Duration::ZERO
                    } else {
                        LOOK_EVERY
                    }
                }
                Err(why) => {
                    link.failed("events", &why);
                    TRY_AGAIN
                }
            },
            false => LOOK_EVERY,
        };
        if !link.wait(pause).await {
            return;
        }
    }
}

async fn send_some(link: &Link) -> Result<usize, String> {
    let due = link.daemon.due_events(BATCH).await;
    let due = due.map_err(|e| e.to_string())?;
    let count = due.len();
    let mut under_way = Vec::new();
    for (number, event) in due {
        under_way.push((number, send(link, number, event).await?));
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
            // Those behind it are sent again.
            Err(why) => {
                failed = Some(why.to_string());
                break;
            }
        }
    }
    if let Some(up_to) = up_to {
        let noted = link.daemon.events_sent(up_to).await;
        noted.map_err(|e| e.to_string())?;
    }
    failed.map_or(Ok(count), Err)
}

async fn send(link: &Link, number: i64, event: EventRow) -> Result<Option<UnderWay>, String> {
    let Some(hob) = event.device.filter(|hob| ihd_daemon::config::is_name(hob)) else {
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
