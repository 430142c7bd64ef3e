//! Worker: takes windows from the queue, identifies R(t) and L(t), publishes the results. A worker has no state: if it is killed, its
//! windows go to another one, and of two results of one window the server accepts the first.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::{AckKind, Context, Message};
use futures_util::StreamExt;
use ihd_daemon::learning::WorkerAnswer;
use ihd_link::Window;
use ihd_model::FleetWorker;
use ihd_train::NetworkConfig;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

use crate::clock::now_ms;
use crate::dead_letters;
use crate::jetstream::{self, ACK_WAIT, JetStreamError, MAX_DELIVERIES, MAX_PASSED_ON, PER_THREAD};
use crate::names;
use crate::wire::{AnswerMessage, WindowMessage};

/// Duration of one request for windows.
const REQUEST_TIME: Duration = Duration::from_secs(5);

/// Pause after a failure.
const TRY_AGAIN: Duration = Duration::from_secs(2);

/// Delay after which a failed window goes to the next worker.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Delay of a window whose edge does not accept answers of this worker.
const LEFT_TO_OTHERS_FOR: Duration = Duration::from_secs(10);

/// Period of the worker's card.
const PUBLISH_PERIOD: Duration = Duration::from_secs(10);

/// Function that identifies a window: the worker's name, the window, the skew of its channels in seconds, the network's settings.
pub type Identify = fn(String, &Window, Option<f64>, NetworkConfig) -> WorkerAnswer;

/// Settings of a worker.
#[derive(Clone, Debug)]
pub struct WorkerSettings {
    /// Its name in the fleet.
    pub name: String,
    /// Number of threads, at least one.
    pub threads: usize,
    /// The network's settings.
    pub network: NetworkConfig,
    /// Function that identifies: [`WorkerAnswer::compute`], or another one to measure everything else.
    pub identify: Identify,
}

/// Counts of a worker.
#[derive(Debug, Default)]
pub struct WorkerCounts {
    /// Windows in progress.
    pub busy: AtomicU32,
    /// Results published first by this worker.
    pub done: AtomicU64,
    /// Results that another worker had published before.
    pub known: AtomicU64,
    /// Failed windows.
    pub failed: AtomicU64,
    /// Windows given up for good.
    pub dead: AtomicU64,
    /// Windows left to other workers, because their edge has refuted answers of this one.
    pub distrusted: AtomicU64,
}

struct Worker {
    context: Context,
    settings: WorkerSettings,
    counts: Arc<WorkerCounts>,
    threads: Semaphore,
}

/// Runs until `stop` becomes `true`; windows in progress are finished.
///
/// # Errors
/// [`JetStreamError`] if the fleet was not initialised; later failures are retried.
pub async fn run(
    context: Context,
    settings: WorkerSettings,
    counts: Arc<WorkerCounts>,
    mut stop: watch::Receiver<bool>,
) -> Result<(), JetStreamError> {
    // Reports a fleet that was not initialised at once.
    let mut known_consumer = Some(consumer(&context).await?);
    let threads = settings.threads.max(1);
    let slots = Arc::new(Semaphore::new(threads * PER_THREAD));
    let worker = Arc::new(Worker {
        threads: Semaphore::new(threads),
        context,
        settings,
        counts,
    });
    let mut tasks = JoinSet::new();
    let publishing = tokio::spawn(publish_cards(Arc::clone(&worker)));
    let stopped = async {
        let _ = stop.wait_for(|&stopping| stopping).await;
    };
    tokio::pin!(stopped);
    loop {
        let working = async {
            let consumer = match known_consumer.take() {
                Some(consumer) => consumer,
                None => consumer(&worker.context).await?,
            };
            fetch_windows(&worker, &consumer, &slots, &mut tasks).await?;
            known_consumer = Some(consumer);
            Ok::<(), JetStreamError>(())
        };
        let worked = tokio::select! {
            () = &mut stopped => break,
            worked = working => worked,
        };
        if let Err(why) = worked {
            tracing::warn!(%why, "the queue cannot be read; tried again");
            tokio::select! {
                () = &mut stopped => break,
                () = tokio::time::sleep(TRY_AGAIN) => {}
            }
        }
    }
    // Windows that wait for a thread go to another worker at once; the others are finished.
    worker.threads.close();
    while tasks.join_next().await.is_some() {}
    publishing.abort();
    worker.remove_card().await;
    Ok(())
}

async fn consumer(context: &Context) -> Result<Consumer<pull::Config>, JetStreamError> {
    let consumer = context.get_consumer_from_stream(names::WORKERS, names::WINDOWS);
    consumer
        .await
        .map_err(|e| jetstream::missing(names::WINDOWS, e))
}

/// Fetches as many windows as there are free slots.
async fn fetch_windows(
    worker: &Arc<Worker>,
    consumer: &Consumer<pull::Config>,
    slots: &Arc<Semaphore>,
    tasks: &mut JoinSet<()>,
) -> Result<(), JetStreamError> {
    let failed = |e: String| JetStreamError::new(names::WINDOWS, e);
    let first = Arc::clone(slots).acquire_owned().await;
    let first = first.map_err(|e| failed(e.to_string()))?;
    let mut free = vec![first];
    while let Ok(permit) = Arc::clone(slots).try_acquire_owned() {
        free.push(permit);
    }
    let fetched = consumer
        .fetch()
        .max_messages(free.len())
        .expires(REQUEST_TIME);
    let mut fetched = fetched
        .messages()
        .await
        .map_err(|e| failed(e.to_string()))?;
    while let Some(message) = fetched.next().await {
        let message = message.map_err(|e| failed(e.to_string()))?;
        let Some(permit) = free.pop() else {
            // More than requested: another worker gets it.
            let _ = message.ack_with(AckKind::Nak(None)).await;
            continue;
        };
        tasks.spawn(process(Arc::clone(worker), message, permit));
    }
    while tasks.try_join_next().is_some() {}
    Ok(())
}

async fn process(worker: Arc<Worker>, message: Message, permit: OwnedSemaphorePermit) {
    worker.counts.busy.fetch_add(1, Relaxed);
    let outcome = worker.process(&message).await;
    worker.counts.busy.fetch_sub(1, Relaxed);
    if let Err(why) = outcome {
        worker.counts.failed.fetch_add(1, Relaxed);
        tracing::warn!(%why, subject = %message.subject, "a window goes to the next worker");
        let _ = message.ack_with(AckKind::Nak(Some(AGAIN_AFTER))).await;
    }
    drop(permit);
}

impl Worker {
    /// Processes a window; on `Ok` it is done for good.
    async fn process(&self, message: &Message) -> Result<(), String> {
        let delivered = message.info().map_err(|e| e.to_string())?.delivered;
        let read = WindowMessage::from_bytes(&message.payload);
        let window = match read {
            Ok(window) if *message.subject == *names::window(&window.hob) => window,
            Ok(window) => {
                let why = format!(
                    "it says it is of {:?}, which its subject denies",
                    window.hob
                );
                return self.bury(message, None, &why).await;
            }
            Err(why) => return self.bury(message, None, &why.to_string()).await,
        };
        let key = (window.boot, window.window.seq);
        match next_step(&window, &self.settings.name, delivered) {
            Step::Identify => {}
            Step::LeaveToOthers => {
                self.leave_to_others(message, &window.hob).await;
                return Ok(());
            }
            Step::GiveUp => {
                let times = delivered - 1;
                let why = format!("it was given to workers {times} times without a result");
                return self.bury(message, Some(key), &why).await;
            }
        }
        let Some(answer) = self.answer(&window, message).await? else {
            let _ = message.ack_with(AckKind::Nak(None)).await;
            return Ok(());
        };
        let result = AnswerMessage {
            boot: window.boot,
            seq: window.window.seq,
            window_at_ms: window.at_ms,
            at_ms: now_ms(),
            answer,
            hob: window.hob,
        };
        self.publish(&result).await?;
        // If this is lost, the window comes again and its result is refused as a duplicate.
        message.double_ack().await.map_err(|e| e.to_string())
    }

    /// Returns a window to the queue: its edge has refuted answers of this worker.
    async fn leave_to_others(&self, message: &Message, hob: &str) {
        if self.counts.distrusted.fetch_add(1, Relaxed) == 0 {
            tracing::error!(
                hob,
                "its edge has refuted answers of this worker: `ihd-fleet status` says why; windows of it are left to others"
            );
        }
        let _ = message
            .ack_with(AckKind::Nak(Some(LEFT_TO_OTHERS_FOR)))
            .await;
    }

    /// Identifies a window on a thread of its own and extends the server's time-out meanwhile; `None` if the worker is stopping.
    async fn answer(
        &self,
        window: &WindowMessage,
        message: &Message,
    ) -> Result<Option<WorkerAnswer>, String> {
        let waiting = async {
            let permit = self.threads.acquire().await.ok()?;
            let (skew_s, by) = (window.skew_s, self.settings.name.clone());
            let (window, network) = (window.window.clone(), self.settings.network.clone());
            let identify = self.settings.identify;
            let fitting =
                tokio::task::spawn_blocking(move || identify(by, &window, skew_s, network));
            let fit = fitting.await;
            drop(permit);
            Some(fit.map_err(|_| "identifying it panicked".to_owned()))
        };
        tokio::pin!(waiting);
        let mut progress = tokio::time::interval(ACK_WAIT / 3);
        progress.tick().await;
        loop {
            tokio::select! {
                fit = &mut waiting => return fit.transpose(),
                _ = progress.tick() => {
                    let _ = message.ack_with(AckKind::Progress).await;
                }
            }
        }
    }

    async fn publish(&self, result: &AnswerMessage) -> Result<(), String> {
        let payload = result.to_bytes().map_err(|e| e.to_string())?;
        let message = PublishMessage::build()
            .payload(payload.into())
            .expected_last_subject_sequence(0);
        let subject = names::result(&result.hob, result.boot, result.seq);
        let sent = self.context.send_publish(subject, message).await;
        match sent.map_err(|e| e.to_string())?.await {
            Ok(_) => {
                self.counts.done.fetch_add(1, Relaxed);
                Ok(())
            }
            Err(why) if why.kind() == PublishErrorKind::WrongLastSequence => {
                self.counts.known.fetch_add(1, Relaxed);
                Ok(())
            }
            Err(why) => Err(format!("its result is not published: {why}")),
        }
    }

    /// Gives a window up: publishes it as a dead letter, with the reason.
    async fn bury(
        &self,
        message: &Message,
        key: Option<(u32, u32)>,
        why: &str,
    ) -> Result<(), String> {
        tracing::error!(subject = %message.subject, why, "a window is given up");
        dead_letters::bury(&self.context, message, key, &self.settings.name, why).await?;
        self.counts.dead.fetch_add(1, Relaxed);
        message.double_ack().await.map_err(|e| e.to_string())
    }

    fn card(&self) -> FleetWorker {
        let counts = &self.counts;
        FleetWorker {
            name: self.settings.name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            threads: u32::try_from(self.settings.threads).unwrap_or(u32::MAX),
            busy: counts.busy.load(Relaxed),
            done: counts.done.load(Relaxed),
            failed: counts.failed.load(Relaxed) + counts.dead.load(Relaxed),
            last_seen_ms: now_ms(),
        }
    }

    async fn remove_card(&self) {
        if let Ok(bucket) = jetstream::bucket(&self.context, names::WORKER_CARDS).await {
            // On failure the entry expires.
            let _ = bucket.delete(&self.settings.name).await;
        }
    }
}

/// Step of a worker with a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Identify,
    LeaveToOthers,
    GiveUp,
}

/// Returns the step of a worker with a window that is delivered for the `delivered`-th time. A window left to others counts as delivered, too:
/// only a worker that may identify it gives it up, and later.
fn next_step(window: &WindowMessage, worker: &str, delivered: i64) -> Step {
    let most = match window.not_for.is_empty() {
        true => MAX_DELIVERIES,
        false => MAX_PASSED_ON,
    };
    if window.not_for.iter().any(|name| name == worker) {
        Step::LeaveToOthers
    } else if delivered > most {
        Step::GiveUp
    } else {
        Step::Identify
    }
}

/// Publishes the worker's card periodically.
async fn publish_cards(worker: Arc<Worker>) {
    loop {
        if let Ok(card) = serde_json::to_vec(&worker.card()) {
            let (context, name) = (&worker.context, &worker.settings.name);
            // A failure is repaired by the next card.
            let _ = jetstream::put(context, names::WORKER_CARDS, name, card).await;
        }
        tokio::time::sleep(PUBLISH_PERIOD).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A worker that an edge distrusts gets a window more often than any window may be tried.
    #[test]
    fn a_window_that_a_distrusted_worker_passed_on_is_tried_by_another() {
        let mut window = crate::wire::tests::window_message();
        window.not_for = vec!["liar".to_owned()];
        for delivered in 1..=20 {
            let step = next_step(&window, "liar", delivered);
            assert_eq!(step, Step::LeaveToOthers, "delivery {delivered}");
        }
        assert_eq!(next_step(&window, "honest", 21), Step::Identify);
        // Where it ends the worker each time, somebody gives it up.
        assert_eq!(next_step(&window, "honest", 501), Step::GiveUp);
        window.not_for.clear();
        assert_eq!(next_step(&window, "honest", 5), Step::Identify);
        assert_eq!(next_step(&window, "honest", 6), Step::GiveUp);
    }
}
