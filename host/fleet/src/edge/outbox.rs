//! From the store to the fleet: windows that nobody has identified, results of those that were identified here. What the fleet has not
//! acknowledged stays due, and is sent again under the same number.

use std::sync::Arc;
use std::time::{Duration, Instant};

use async_nats::jetstream::context::{PublishAckFuture, PublishErrorKind};
use async_nats::jetstream::message::PublishMessage;
use ihd_daemon::learning::Answer;
use ihd_daemon::model::What;
use ihd_store::{Due, DueWindow, Sent};
use tokio::sync::broadcast::error::RecvError;

use super::{Link, TRY_AGAIN, now_ms};
use crate::identity::Identity;
use crate::names;
use crate::wire::{AnswerMessage, MessageError, WindowMessage};

/// Windows under way at once.
const BATCH: usize = 64;

/// Between two looks where nothing was heard of.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long the fleet has for a result, in milliseconds. A server that has lost its store, or results that were deleted before this edge
/// took them, cost that long; windows that were given up are tried again once a day.
const ANSWERED_WITHIN_MS: i64 = 24 * 3_600_000;

/// Between two looks for what was never answered.
const MISSED_EVERY: Duration = Duration::from_secs(3_600);

/// Why something was not sent.
#[derive(Debug, thiserror::Error)]
enum SendError {
    #[error(transparent)]
    Store(#[from] ihd_daemon::StoreTrouble),
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error("{0}")]
    Publish(#[from] async_nats::jetstream::context::PublishError),
}

/// What is on its way.
struct UnderWay {
    due: DueWindow,
    what: Sent,
    acknowledged: PublishAckFuture,
}

/// Sends what is due until the edge ends.
pub async fn run(link: Arc<Link>) {
    let identity = loop {
        match link.daemon.fleet_secret().await {
            Ok(secret) => break Identity::new(secret),
            Err(why) => link.failed("store", &why),
        }
        if !link.wait(TRY_AGAIN).await {
            return;
        }
    };
    let mut notices = link.daemon.watch();
    let mut missed_at: Option<Instant> = None;
    loop {
        let now = Instant::now();
        if link.is_connected() && missed_at.is_none_or(|at| now - at >= MISSED_EVERY) {
            missed_at = Some(now);
            send_again(&link).await;
        }
        let trusted = link.is_connected() && link.state().answers.are_in_time(now);
        link.daemon.trust_fleet(trusted);
        let sent = match link.is_connected() && link.serves() {
            true => match send_some(&link, &identity).await {
                Ok(sent) => {
                    link.works();
                    sent
                }
                Err(why) => {
                    link.failed("sending", &why);
                    link.daemon.trust_fleet(false);
                    if !link.wait(TRY_AGAIN).await {
                        return;
                    }
                    0
                }
            },
            false => 0,
        };
        // Whole batches follow each other.
        if sent == BATCH {
            continue;
        }
        let news = async {
            loop {
                match notices.recv().await {
                    Ok(notice) if matches!(notice.what, What::WindowStored { .. }) => return,
                    Ok(_) => {}
                    Err(RecvError::Lagged(_)) => return,
                    // The daemon is ending; so is the edge.
                    Err(RecvError::Closed) => std::future::pending().await,
                }
            }
        };
        let next = tokio::time::timeout(LOOK_EVERY, news);
        if link.unless_stopping(next).await.is_none() {
            return;
        }
    }
}

/// What was never answered is sent again.
async fn send_again(link: &Link) {
    match link.daemon.due_again(now_ms() - ANSWERED_WITHIN_MS).await {
        Ok(0) => {}
        Ok(windows) => {
            tracing::warn!(windows, "never answered by the fleet: they are sent again");
        }
        Err(why) => link.failed("store", &why),
    }
}

/// Sends a batch and waits for its acknowledgements; how many were due.
async fn send_some(link: &Link, identity: &Identity) -> Result<usize, SendError> {
    let due = link.daemon.due(BATCH).await?;
    let count = due.len();
    let mut under_way = Vec::new();
    let mut sent = Vec::new();
    let mut failed = None;
    for due in due {
        match send(link, identity, &due).await {
            Ok(Some((what, acknowledged))) => under_way.push(UnderWay {
                due,
                what,
                acknowledged,
            }),
            Ok(None) => sent.push((due, Sent::Result)),
            Err(why) => {
                failed = Some(why);
                break;
            }
        }
    }
    for one in under_way {
        match one.acknowledged.await {
            Ok(_) => {
                if one.what == Sent::Window {
                    let key = (one.due.device.clone(), one.due.boot, one.due.seq);
                    link.state().answers.sent(key, Instant::now());
                }
                sent.push((one.due, one.what));
            }
            // Another one has published a result of this window before.
            Err(why)
                if one.what == Sent::Result
                    && why.kind() == PublishErrorKind::WrongLastSequence =>
            {
                sent.push((one.due, one.what));
            }
            Err(why) => failed = Some(why.into()),
        }
    }
    link.daemon.sent(sent).await?;
    failed.map_or(Ok(count), Err)
}

/// Publishes what there is of a window that is due; none where there is nothing any more.
async fn send(
    link: &Link,
    identity: &Identity,
    due: &DueWindow,
) -> Result<Option<(Sent, PublishAckFuture)>, SendError> {
    let (hob, boot, seq) = (&due.device, due.boot, due.seq);
    let (subject, message, what) = match link.daemon.read_due(due.clone()).await? {
        Due::Window(window) => {
            let message = WindowMessage {
                hob: hob.clone(),
                boot,
                at_ms: due.at_ms,
                skew_s: link.daemon.skew_s(hob),
                not_for: link.daemon.distrusted(),
                window: *window,
            };
            let message = PublishMessage::build()
                .payload(message.to_bytes()?.into())
                .message_id(identity.of_window(hob, boot, seq));
            (names::window(hob), message, Sent::Window)
        }
        Due::Result(_) => {
            let message = identified_here(link, due);
            let message = PublishMessage::build()
                .payload(message.to_bytes()?.into())
                .expected_last_subject_sequence(0);
            (names::result(hob, boot, seq), message, Sent::Result)
        }
        Due::Gone => {
            tracing::warn!(hob, boot, seq, "its samples are gone: it is not sent");
            return Ok(None);
        }
    };
    let under_way = link.context.send_publish(subject, message).await?;
    Ok(Some((what, under_way)))
}

/// Takes the place of a worker's answer to a window that this edge has identified. The result itself stays in its store.
fn identified_here(link: &Link, due: &DueWindow) -> AnswerMessage {
    AnswerMessage {
        hob: due.device.clone(),
        boot: due.boot,
        seq: due.seq,
        window_at_ms: due.at_ms,
        at_ms: now_ms(),
        answer: Answer {
            by: link.edge.clone(),
            skew_s: None,
            found: Err("its edge has identified it".to_owned()),
            busy: Duration::ZERO,
        },
    }
}
