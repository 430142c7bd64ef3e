//! From the store to the fleet: windows that nobody has identified, results of those that were identified here. What the fleet has not
//! acknowledged stays due, and is sent again under the same number.

use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::StoreTrouble;
use ihd_daemon::learning::WorkerAnswer;
use ihd_daemon::model::What;
use ihd_store::{DeliveryState, DueWindow, FleetMark, OutboxItem};
use tokio::sync::broadcast::error::RecvError;
use tokio::time::Instant;

use super::acknowledged::{self, all_until};
use super::{Link, TRY_AGAIN};
use crate::identity::Identity;
use crate::names;
use crate::server::{Acknowledged, Outgoing, PublishTrouble, UnderWay};
use crate::wire::{AnswerMessage, MessageError, WindowMessage};

/// Windows under way at once.
const BATCH: usize = 64;

/// Between two looks where nothing was heard of.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Longest time of a whole batch, from its first window to its last acknowledgement.
const BATCH_WITHIN: Duration = Duration::from_secs(8);

/// How long the fleet has for a result, in milliseconds, since it got the window. Results that were deleted before this edge took them cost
/// that long; that a server has lost what it had is seen before ([`send_all_again`]).
const ANSWERED_WITHIN_MS: i64 = 24 * 3_600_000;

/// Between two looks for what was never answered.
const MISSED_EVERY: Duration = Duration::from_secs(3_600);

/// Why something was not sent.
#[derive(Debug, thiserror::Error)]
enum SendError {
    #[error(transparent)]
    Store(#[from] StoreTrouble),
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Publish(#[from] PublishTrouble),
    #[error("no acknowledgement within {} s", BATCH_WITHIN.as_secs())]
    Late,
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
        let is_admitted = link.is_admitted();
        if is_admitted && missed_at.is_none_or(|at| now - at >= MISSED_EVERY) {
            missed_at = Some(now);
            send_again(&link).await;
        }
        let sent = match is_admitted {
            true => send_some(&link, &identity).await.map(Some),
            false => Ok(None),
        };
        let works = matches!(sent, Ok(Some(_)));
        link.state().signs.sent(works, Instant::now());
        link.renew();
        match sent {
            // Whole batches follow each other.
            Ok(Some(BATCH)) => {
                link.works("sending");
                continue;
            }
            Ok(Some(_)) => link.works("sending"),
            Ok(None) => {}
            Err(why) => {
                link.failed("sending", &why);
                if !link.wait(TRY_AGAIN).await {
                    return;
                }
                continue;
            }
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
    match link
        .daemon
        .due_again(link.daemon.now_ms() - ANSWERED_WITHIN_MS)
        .await
    {
        Ok(0) => {}
        Ok(windows) => {
            tracing::warn!(windows, "never answered by the fleet: they are sent again");
        }
        Err(why) => link.failed("store", &why),
    }
}

/// The server has lost what it had: all that it has not answered is due again.
pub(super) async fn send_all_again(link: &Link, why: &str) -> Result<(), StoreTrouble> {
    let windows = link.daemon.due_again(i64::MAX).await?;
    link.state().answers.lost();
    tracing::warn!(
        windows,
        why,
        "the fleet's server has lost what it had: they are sent again"
    );
    Ok(())
}

/// Sends a batch and waits for its acknowledgements, all at once; how many were due. Those that are acknowledged in time are noted, whatever
/// becomes of the others.
async fn send_some(link: &Link, identity: &Identity) -> Result<usize, SendError> {
    let due = link.daemon.due(BATCH).await?;
    let count = due.len();
    let deadline = Instant::now() + BATCH_WITHIN;
    let mut batch = Batch::default();
    let sending = batch.send(link, identity, due);
    let mut failed = match tokio::time::timeout_at(deadline, sending).await {
        Ok(sent) => sent.err(),
        Err(_) => Some(SendError::Late),
    };
    let mut under_way = std::mem::take(&mut batch.under_way);
    let heard = |(due, what, acknowledged)| {
        if let Err(why) = batch.heard(due, what, acknowledged) {
            failed = Some(why);
        }
    };
    if !all_until(&mut under_way, deadline, heard).await {
        failed = Some(SendError::Late);
    }
    batch.note(link).await?;
    failed.map_or(Ok(count), Err)
}

type Heard = (
    DueWindow,
    DeliveryState,
    Result<Acknowledged, PublishTrouble>,
);

/// Outcome of a batch so far.
#[derive(Default)]
struct Batch {
    under_way: acknowledged::UnderWay<Heard>,
    sent: Vec<(DueWindow, DeliveryState)>,
    /// Numbers in the queue of windows that came there for the first time.
    numbers: Vec<u64>,
}

impl Batch {
    /// Sends until something fails.
    async fn send(
        &mut self,
        link: &Link,
        identity: &Identity,
        due: Vec<DueWindow>,
    ) -> Result<(), SendError> {
        for due in due {
            match send(link, identity, &due).await? {
                Some((what, acknowledged)) => {
                    let acknowledged = async move { (due, what, acknowledged.await) };
                    self.under_way.push(Box::pin(acknowledged));
                }
                None => self.sent.push((due, DeliveryState::Nothing)),
            }
        }
        Ok(())
    }

    fn heard(
        &mut self,
        due: DueWindow,
        what: DeliveryState,
        acknowledged: Result<Acknowledged, PublishTrouble>,
    ) -> Result<(), SendError> {
        match acknowledged {
            Ok(message) => {
                if what == DeliveryState::Window && !message.is_duplicate {
                    self.numbers.push(message.number);
                }
            }
            // Another one has published a result of this window before.
            Err(PublishTrouble::Occupied) if what == DeliveryState::Result => {}
            Err(why) => return Err(why.into()),
        }
        self.sent.push((due, what));
        Ok(())
    }

    /// Notes what was acknowledged; before that, that the queue has begun to count anew.
    async fn note(self, link: &Link) -> Result<(), StoreTrouble> {
        let numbers = self
            .numbers
            .iter()
            .map(|n| i64::try_from(*n).unwrap_or(i64::MAX));
        if let (Some(first), Some(last)) = (numbers.clone().min(), numbers.max()) {
            let before = link.daemon.fleet_mark(FleetMark::LastWindow).await?;
            if before.is_some_and(|before| first <= before) {
                send_all_again(link, "its queue counts from the beginning").await?;
            }
            link.daemon.mark_fleet(FleetMark::LastWindow, last).await?;
        }
        let now = Instant::now();
        for (due, _) in self
            .sent
            .iter()
            .filter(|(_, what)| *what == DeliveryState::Window)
        {
            let key = (due.device.clone(), due.boot, due.seq);
            link.state().answers.sent(key, now);
        }
        link.daemon.sent(self.sent).await
    }
}

/// Publishes what there is of a window that is due; none where there is nothing any more.
async fn send(
    link: &Link,
    identity: &Identity,
    due: &DueWindow,
) -> Result<Option<(DeliveryState, UnderWay)>, SendError> {
    let (hob, boot, seq) = (&due.device, due.boot, due.seq);
    let (message, what) = match link.daemon.read_due(due.clone()).await? {
        OutboxItem::Window(window) => {
            let message = WindowMessage {
                hob: hob.clone(),
                boot,
                at_ms: due.at_ms,
                skew_s: link.daemon.skew_s(hob),
                not_for: link.daemon.distrusted(),
                window: *window,
            };
            let message = Outgoing {
                subject: names::window(hob),
                payload: message.to_bytes()?.into(),
                number: Some(identity.of_window(hob, boot, seq)),
                after: None,
            };
            (message, DeliveryState::Window)
        }
        OutboxItem::Result(_) => {
            let message = identified_here(link, due);
            let message = Outgoing {
                subject: names::result(hob, boot, seq),
                payload: message.to_bytes()?.into(),
                number: None,
                after: Some(0),
            };
            (message, DeliveryState::Result)
        }
        OutboxItem::Gone => {
            tracing::warn!(hob, boot, seq, "its samples are gone: it is given up");
            return Ok(None);
        }
    };
    let under_way = link.server.publish(message).await?;
    Ok(Some((what, under_way)))
}

/// Takes the place of a worker's answer to a window that this edge has identified. The result itself stays in its store.
fn identified_here(link: &Link, due: &DueWindow) -> AnswerMessage {
    AnswerMessage {
        hob: due.device.clone(),
        boot: due.boot,
        seq: due.seq,
        window_at_ms: due.at_ms,
        at_ms: link.daemon.now_ms(),
        answer: WorkerAnswer {
            by: link.edge.clone(),
            skew_s: None,
            found: Err("its edge has identified it".to_owned()),
            busy: Duration::ZERO,
        },
    }
}
