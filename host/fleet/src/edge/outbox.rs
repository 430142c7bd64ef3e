//! Windows of the store to the fleet: unidentified ones, and the results of those identified here. A window without acknowledgement stays
//! due, and is sent again under the same number.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::StoreThreadError;
use ihd_daemon::learning::WorkerAnswer;
use ihd_model::{DaemonEvent, EventKind};
use ihd_store::{DeliveryState, DueWindow, FleetMark, OutboxItem, StoreError};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::Instant;

use super::acknowledged::{self, all_until};
use super::link::{Link, RESULTS, SENDING, STORE};
use super::refusals::RETRY_PAUSE;
use crate::message_ids::MessageIds;
use crate::names;
use crate::stream_message::{Acknowledged, Outgoing, PendingAck, PublishFailure};
use crate::wire::{AnswerMessage, MessageError, WindowMessage};

/// Windows sent at once.
const BATCH: usize = 64;

/// Period of polling the store without a notice.
const POLL_PERIOD: Duration = Duration::from_secs(1);

/// Time-out of a batch, from its first window to its last acknowledgement.
const BATCH_WITHIN: Duration = Duration::from_secs(8);

/// Longest wait for a result in milliseconds. It only matters for results that were deleted before this edge received them; loss of the
/// server's data is detected earlier ([`resend_all`]).
const ANSWERED_WITHIN_MS: i64 = 24 * 3_600_000;

/// Most windows without an answer that are identified here after [`ANSWERED_WITHIN_MS`], so that the learner is not flooded.
const MAX_IDENTIFIED_HERE: usize = 1_024;

/// Period of the search for unanswered windows.
const RESEND_PERIOD: Duration = Duration::from_secs(3_600);

/// Error of sending a window.
#[derive(Debug, thiserror::Error)]
enum SendError {
    #[error(transparent)]
    Store(#[from] StoreThreadError),
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error("no acknowledgement within {} s", BATCH_WITHIN.as_secs())]
    Late,
}

/// Sends due windows until the edge stops.
pub async fn run(link: Arc<Link>) {
    let Some(message_ids) = read_message_ids(&link).await else {
        return;
    };
    let mut notices = link.daemon.watch();
    let mut resent_at: Option<Instant> = None;
    loop {
        let now = Instant::now();
        let is_admitted = link.is_admitted();
        if is_admitted && resent_at.is_none_or(|at| now - at >= RESEND_PERIOD) {
            resent_at = Some(now);
            resend_unanswered(&link).await;
        }
        let sent = match is_admitted {
            true => send_batch(&link, &message_ids).await.map(Some),
            false => Ok(None),
        };
        let works = matches!(sent, Ok(Some(_))) && link.state().refusals.are_own(SENDING);
        link.state().signs.sent(works, Instant::now());
        link.renew_delegation();
        match sent {
            Ok(Some(is_more)) => {
                link.works(SENDING);
                if link.is_stopping() {
                    return;
                }
                if is_more {
                    continue;
                }
            }
            Ok(None) => {}
            Err(why) => {
                link.failed(SENDING, &why);
                if !link.wait(RETRY_PAUSE).await {
                    return;
                }
                continue;
            }
        }
        let next = tokio::time::timeout(POLL_PERIOD, wait_for_window(&mut notices));
        if link.unless_stopping(next).await.is_none() {
            return;
        }
    }
}

/// Reads the secret of the messages' ids, as often as needed; `None` if the edge stops before.
async fn read_message_ids(link: &Link) -> Option<MessageIds> {
    loop {
        match link.daemon.fleet().secret().await {
            Ok(secret) => return Some(MessageIds::new(secret)),
            Err(why) => link.failed(STORE, &why),
        }
        if !link.wait(RETRY_PAUSE).await {
            return None;
        }
    }
}

/// Waits until the daemon has stored a window.
async fn wait_for_window(notices: &mut Receiver<Arc<DaemonEvent>>) {
    loop {
        match notices.recv().await {
            Ok(notice) if matches!(notice.kind, EventKind::WindowStored { .. }) => return,
            Ok(_) => {}
            Err(RecvError::Lagged(_)) => return,
            // The daemon is stopping, and with it the edge.
            Err(RecvError::Closed) => std::future::pending().await,
        }
    }
}

/// Makes unanswered windows due again. Those that stay unanswered are identified here (given_up.rs): the place of their
/// answers may be taken.
async fn resend_unanswered(link: &Link) {
    let (fleet, before_ms) = (
        link.daemon.fleet(),
        link.daemon.view().now_ms() - ANSWERED_WITHIN_MS,
    );
    match fleet.unanswered(before_ms, 0, MAX_IDENTIFIED_HERE).await {
        Ok(windows) => {
            for DueWindow {
                device, boot, seq, ..
            } in windows
            {
                link.state().oddities.expect_none((device, boot, seq));
            }
        }
        Err(why) => link.failed(STORE, &why),
    }
    match fleet.requeue_unanswered(before_ms).await {
        Ok(0) => {}
        Ok(windows) => {
            tracing::warn!(windows, "never answered by the fleet: they are sent again");
        }
        Err(why) => link.failed(STORE, &why),
    }
}

/// Makes all unanswered windows due again, after the server has lost its data.
pub(super) async fn resend_all(link: &Link, why: &str) -> Result<(), StoreThreadError> {
    let windows = link.daemon.fleet().requeue_unanswered(i64::MAX).await?;
    link.state().answers.clear();
    tracing::warn!(
        windows,
        why,
        "the fleet's server has lost what it had: they are sent again"
    );
    Ok(())
}

/// Sends a batch and waits for all acknowledgements together; returns `true` if more may be due. Acknowledged windows are recorded, even if
/// others fail. A hob whose windows are refused is left out of the next batches; it comes back with one window.
async fn send_batch(link: &Link, message_ids: &MessageIds) -> Result<bool, SendError> {
    let began = Instant::now();
    let mut hobs = link.hobs_to_try(SENDING);
    let (refused, unanswered) = {
        let refusals = &link.state().refusals;
        (refusals.hobs(SENDING), refusals.hobs(RESULTS))
    };
    hobs.retain(|hob| !unanswered.contains(hob));
    let mut due = link.daemon.fleet().due_windows(hobs, BATCH).await?;
    let is_full = due.len() == BATCH;
    let mut tried = BTreeSet::new();
    due.retain(|w| !refused.contains(&w.device) || tried.insert(w.device.clone()));
    let deadline = began + BATCH_WITHIN;
    let mut batch = Batch::default();
    let sending = batch.send(link, message_ids, due);
    let mut failed = match tokio::time::timeout_at(deadline, sending).await {
        Ok(sent) => sent.err(),
        Err(_) => Some(SendError::Late),
    };
    let mut under_way = std::mem::take(&mut batch.under_way);
    let record = |(due, what, acknowledged)| batch.record(due, what, acknowledged);
    if !all_until(&mut under_way, deadline, record).await {
        failed = Some(SendError::Late);
    }
    let is_more = is_full || !batch.refused.is_empty();
    for hob in batch
        .accepted
        .difference(&batch.refused.keys().cloned().collect())
    {
        link.accepted(SENDING, hob);
    }
    for (hob, why) in &batch.refused {
        link.refused(SENDING, hob, why, began);
    }
    batch.note(link).await?;
    failed.map_or(Ok(is_more), Err)
}

/// Sent window with its acknowledgement.
type SentWindow = (
    DueWindow,
    DeliveryState,
    Result<Acknowledged, PublishFailure>,
);

/// Outcome of a batch so far.
#[derive(Default)]
struct Batch {
    under_way: acknowledged::PendingAcks<SentWindow>,
    sent: Vec<(DueWindow, DeliveryState)>,
    /// Numbers in the queue, without duplicates.
    numbers: Vec<u64>,
    accepted: BTreeSet<String>,
    /// Reason of the first refusal of each hob.
    refused: BTreeMap<String, PublishFailure>,
}

impl Batch {
    /// Sends up to the first failure, of each hob up to its first refusal; damaged windows are given up.
    async fn send(
        &mut self,
        link: &Link,
        message_ids: &MessageIds,
        due: Vec<DueWindow>,
    ) -> Result<(), SendError> {
        for due in due {
            if self.refused.contains_key(&due.device) {
                continue;
            }
            match send(link, message_ids, &due).await {
                Ok(Some((_, Err(why)))) => self.refuse(due.device, why),
                Ok(Some((what, Ok(acknowledged)))) => {
                    let acknowledged = async move { (due, what, acknowledged.await) };
                    self.under_way.push(Box::pin(acknowledged));
                }
                Ok(None) => self.sent.push((due, DeliveryState::Nothing)),
                Err(SendError::Store(StoreThreadError::Store(why @ StoreError::Window { .. }))) => {
                    tracing::warn!(%why, "a damaged window: it is given up");
                    self.sent.push((due, DeliveryState::Damaged));
                }
                Err(why) => return Err(why),
            }
        }
        Ok(())
    }

    fn record(
        &mut self,
        due: DueWindow,
        what: DeliveryState,
        acknowledged: Result<Acknowledged, PublishFailure>,
    ) {
        match acknowledged {
            Ok(message) => {
                if what == DeliveryState::Window && !message.is_duplicate {
                    self.numbers.push(message.number);
                }
            }
            // The window has a result already.
            Err(PublishFailure::Occupied) if what == DeliveryState::Result => {}
            Err(why) => return self.refuse(due.device, why),
        }
        self.accepted.insert(due.device.clone());
        self.sent.push((due, what));
    }

    fn refuse(&mut self, hob: String, why: PublishFailure) {
        self.refused.entry(hob).or_insert(why);
    }

    /// Stores the acknowledgements; before that, checks whether the queue has begun to count anew.
    async fn note(self, link: &Link) -> Result<(), StoreThreadError> {
        let numbers = self
            .numbers
            .iter()
            .map(|n| i64::try_from(*n).unwrap_or(i64::MAX));
        if let (Some(first), Some(last)) = (numbers.clone().min(), numbers.max()) {
            let before = link.daemon.fleet().mark(FleetMark::LastWindow).await?;
            if before.is_some_and(|before| first <= before) {
                resend_all(link, "its queue counts from the beginning").await?;
            }
            link.daemon
                .fleet()
                .set_mark(FleetMark::LastWindow, last)
                .await?;
        }
        let now = Instant::now();
        for (due, _) in self
            .sent
            .iter()
            .filter(|(_, what)| *what == DeliveryState::Window)
        {
            let key = (due.device.clone(), due.boot, due.seq);
            let mut state = link.state();
            if !state.oddities.is_early(&key) {
                state.answers.insert(key, now);
            }
        }
        link.daemon.fleet().mark_sent(self.sent).await
    }
}

/// Publishes a due window or its result; `None` if its samples are deleted.
async fn send(
    link: &Link,
    message_ids: &MessageIds,
    due: &DueWindow,
) -> Result<Option<(DeliveryState, Result<PendingAck, PublishFailure>)>, SendError> {
    let (hob, boot, seq) = (&due.device, due.boot, due.seq);
    let (message, what) = match link.daemon.fleet().read_due(due.clone()).await? {
        OutboxItem::Window(window) => {
            let message = WindowMessage {
                hob: hob.clone(),
                boot,
                at_ms: due.at_ms,
                skew_s: link.daemon.fleet().skew_s(hob),
                not_for: link.daemon.fleet().distrusted(),
                window: *window,
            };
            let message = Outgoing {
                subject: names::window(hob),
                payload: message.to_bytes()?.into(),
                number: Some(message_ids.window_id(hob, boot, seq)),
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
    Ok(Some((what, link.server.publish(message).await)))
}

/// Returns the answer that takes the place of a worker's for a window identified by this edge. The result itself stays in the store.
fn identified_here(link: &Link, due: &DueWindow) -> AnswerMessage {
    AnswerMessage {
        hob: due.device.clone(),
        boot: due.boot,
        seq: due.seq,
        window_at_ms: due.at_ms,
        at_ms: link.daemon.view().now_ms(),
        answer: WorkerAnswer {
            by: link.edge.clone(),
            skew_s: None,
            load: Err("its edge has identified it".to_owned()),
            busy: Duration::ZERO,
        },
    }
}
