//! Who identifies: takes windows from the queue, finds R(t) and L(t), publishes what it found. A worker keeps nothing: killed at any moment, its
//! windows go to another one, and of two results of one window the server takes the first.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::{self, AckKind, Context};
use futures_util::StreamExt;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_daemon::model::FleetWorker;
use ihd_identify::{IdentifyOptions, Method};
use ihd_store::Curve;
use ihd_train::NetworkConfig;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

use crate::dead;
use crate::edge::now_ms;
use crate::engine::{self, ACK_WAIT, EngineError, MOST_DELIVERIES, PER_THREAD};
use crate::names;
use crate::wire::{AnswerMessage, WindowMessage};

/// How long one request for windows waits.
const ASK_FOR: Duration = Duration::from_secs(5);

/// Between two tries after something failed.
const TRY_AGAIN: Duration = Duration::from_secs(2);

/// When a window that could not be dealt with goes to the next worker.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Time for which a window is left to others whose edge does not believe this worker.
const LEFT_FOR: Duration = Duration::from_secs(10);

/// How often the worker tells how it does.
const TELL_EVERY: Duration = Duration::from_secs(10);

/// What a worker may use.
#[derive(Clone, Debug)]
pub struct WorkerSettings {
    /// Its name in the fleet.
    pub name: String,
    /// Threads that identify, at least one.
    pub threads: usize,
    /// The network's settings.
    pub network: NetworkConfig,
    /// Pretends to work for so long instead of identifying: to measure the rest.
    pub pretend: Option<Duration>,
}

/// What a worker has done.
#[derive(Debug, Default)]
pub struct Figures {
    /// Windows that it is at.
    pub busy: AtomicU32,
    /// Results that it was the first to publish.
    pub done: AtomicU64,
    /// Results that another one had published before.
    pub known: AtomicU64,
    /// Windows that it failed at.
    pub failed: AtomicU64,
    /// Windows that it gave up for good.
    pub dead: AtomicU64,
    /// Windows that it left to others, since their edge has refuted answers of it.
    pub distrusted: AtomicU64,
}

struct Worker {
    context: Context,
    settings: WorkerSettings,
    figures: Arc<Figures>,
    threads: Semaphore,
}

/// Works until `stop` becomes true, with what it is at finished.
///
/// # Errors
/// [`EngineError`] where the fleet was never made; what fails later is tried again.
pub async fn run(
    context: Context,
    settings: WorkerSettings,
    figures: Arc<Figures>,
    mut stop: watch::Receiver<bool>,
) -> Result<(), EngineError> {
    // A fleet that was never made is told at once.
    let mut found = Some(consumer(&context).await?);
    let threads = settings.threads.max(1);
    let slots = Arc::new(Semaphore::new(threads * PER_THREAD));
    let worker = Arc::new(Worker {
        threads: Semaphore::new(threads),
        context,
        settings,
        figures,
    });
    let mut tasks = JoinSet::new();
    let telling = tokio::spawn(tell(Arc::clone(&worker)));
    let stopped = async {
        let _ = stop.wait_for(|&stopping| stopping).await;
    };
    tokio::pin!(stopped);
    loop {
        let working = async {
            let consumer = match found.take() {
                Some(consumer) => consumer,
                None => consumer(&worker.context).await?,
            };
            take(&worker, &consumer, &slots, &mut tasks).await?;
            found = Some(consumer);
            Ok::<(), EngineError>(())
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
    // What waits for a thread goes to another worker at once; what is studied is finished.
    worker.threads.close();
    while tasks.join_next().await.is_some() {}
    telling.abort();
    worker.leave().await;
    Ok(())
}

async fn consumer(context: &Context) -> Result<Consumer<pull::Config>, EngineError> {
    let found = context.get_consumer_from_stream(names::WORKERS, names::WINDOWS);
    found.await.map_err(|e| engine::missing(names::WINDOWS, e))
}

/// Takes as many windows as there is room for.
async fn take(
    worker: &Arc<Worker>,
    consumer: &Consumer<pull::Config>,
    slots: &Arc<Semaphore>,
    tasks: &mut JoinSet<()>,
) -> Result<(), EngineError> {
    let failed = |e: String| EngineError::new(names::WINDOWS, e);
    let first = Arc::clone(slots).acquire_owned().await;
    let first = first.map_err(|e| failed(e.to_string()))?;
    let mut free = vec![first];
    while let Ok(permit) = Arc::clone(slots).try_acquire_owned() {
        free.push(permit);
    }
    let fetched = consumer.fetch().max_messages(free.len()).expires(ASK_FOR);
    let mut fetched = fetched
        .messages()
        .await
        .map_err(|e| failed(e.to_string()))?;
    while let Some(message) = fetched.next().await {
        let message = message.map_err(|e| failed(e.to_string()))?;
        let Some(permit) = free.pop() else {
            // More than was asked for: another one's turn.
            let _ = message.ack_with(AckKind::Nak(None)).await;
            continue;
        };
        tasks.spawn(deal_with(Arc::clone(worker), message, permit));
    }
    while tasks.try_join_next().is_some() {}
    Ok(())
}

async fn deal_with(worker: Arc<Worker>, message: jetstream::Message, permit: OwnedSemaphorePermit) {
    worker.figures.busy.fetch_add(1, Relaxed);
    let outcome = worker.deal(&message).await;
    worker.figures.busy.fetch_sub(1, Relaxed);
    if let Err(why) = outcome {
        worker.figures.failed.fetch_add(1, Relaxed);
        tracing::warn!(%why, subject = %message.subject, "a window goes to the next worker");
        let _ = message.ack_with(AckKind::Nak(Some(AGAIN_AFTER))).await;
    }
    drop(permit);
}

impl Worker {
    /// Deals with a window, for good where this returns `Ok`.
    async fn deal(&self, message: &jetstream::Message) -> Result<(), String> {
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
        if delivered > MOST_DELIVERIES {
            let why = format!(
                "it was given to workers {} times without a result",
                delivered - 1
            );
            return self.bury(message, Some(key), &why).await;
        }
        if window.not_for.contains(&self.settings.name) {
            self.leave_to_others(message, &window.hob).await;
            return Ok(());
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
        // Where this is lost the window comes again, and its result is known.
        message.double_ack().await.map_err(|e| e.to_string())
    }

    /// Leaves a window to others: the edge has refuted answers of this worker.
    async fn leave_to_others(&self, message: &jetstream::Message, hob: &str) {
        if self.figures.distrusted.fetch_add(1, Relaxed) == 0 {
            tracing::error!(
                hob,
                "its edge has refuted answers of this worker: `ihd fleet status` says why; windows of it are left to others"
            );
        }
        let _ = message.ack_with(AckKind::Nak(Some(LEFT_FOR))).await;
    }

    /// Identifies on a thread of its own, and tells the server meanwhile that it goes on; none where the worker is ending.
    async fn answer(
        &self,
        window: &WindowMessage,
        message: &jetstream::Message,
    ) -> Result<Option<WorkerAnswer>, String> {
        let waiting = async {
            let permit = self.threads.acquire().await.ok()?;
            let (skew_s, by) = (window.skew_s, self.settings.name.clone());
            let (window, network) = (window.window.clone(), self.settings.network.clone());
            if let Some(time) = self.settings.pretend {
                tokio::time::sleep(time).await;
            }
            let find = match self.settings.pretend {
                None => tokio::task::spawn_blocking(move || {
                    WorkerAnswer::compute(by, &window, skew_s, network)
                }),
                Some(_) => tokio::task::spawn_blocking(move || pretended(by, &window)),
            };
            let found = find.await;
            drop(permit);
            Some(found.map_err(|_| "identifying it panicked".to_owned()))
        };
        tokio::pin!(waiting);
        let mut progress = tokio::time::interval(ACK_WAIT / 3);
        progress.tick().await;
        loop {
            tokio::select! {
                found = &mut waiting => return found.transpose(),
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
                self.figures.done.fetch_add(1, Relaxed);
                Ok(())
            }
            Err(why) if why.kind() == PublishErrorKind::WrongLastSequence => {
                self.figures.known.fetch_add(1, Relaxed);
                Ok(())
            }
            Err(why) => Err(format!("its result is not published: {why}")),
        }
    }

    /// Gives a window up: it goes to the dead, with why.
    async fn bury(
        &self,
        message: &jetstream::Message,
        key: Option<(u32, u32)>,
        why: &str,
    ) -> Result<(), String> {
        tracing::error!(subject = %message.subject, why, "a window is given up");
        dead::bury(&self.context, message, key, &self.settings.name, why).await?;
        self.figures.dead.fetch_add(1, Relaxed);
        message.double_ack().await.map_err(|e| e.to_string())
    }

    fn card(&self) -> FleetWorker {
        let figures = &self.figures;
        FleetWorker {
            name: self.settings.name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            threads: u32::try_from(self.settings.threads).unwrap_or(u32::MAX),
            busy: figures.busy.load(Relaxed),
            done: figures.done.load(Relaxed),
            failed: figures.failed.load(Relaxed) + figures.dead.load(Relaxed),
            last_seen_ms: now_ms(),
        }
    }

    async fn leave(&self) {
        if let Ok(bucket) = engine::bucket(&self.context, names::WORKER_CARDS).await {
            // Else the entry goes by itself.
            let _ = bucket.delete(&self.settings.name).await;
        }
    }
}

/// Tells the fleet that there is a worker, and how it does.
async fn tell(worker: Arc<Worker>) {
    loop {
        if let Ok(card) = serde_json::to_vec(&worker.card()) {
            let (context, name) = (&worker.context, &worker.settings.name);
            // The next one comes soon.
            let _ = engine::put(context, names::WORKER_CARDS, name, card).await;
        }
        tokio::time::sleep(TELL_EVERY).await;
    }
}

/// The lock-in's R(t) and L(t), in place of the network's.
fn pretended(by: String, window: &ihd_link::Window) -> WorkerAnswer {
    let segment = window.segment();
    let estimate = ihd_identify::run(Method::Lockin, &segment, &IdentifyOptions::default());
    let found = estimate.map_err(|e| e.to_string()).map(|estimate| {
        let curve = Curve {
            t_s: estimate.t_s,
            r_ohm: estimate.r_ohm,
            l_h: estimate.l_h,
            ..Curve::default()
        };
        let curve = curve.thinned();
        StatedLoad {
            t_s: curve.t_s,
            r_ohm: curve.r_ohm,
            l_h: curve.l_h,
            ..StatedLoad::default()
        }
    });
    WorkerAnswer {
        by,
        skew_s: None,
        found,
        busy: Duration::ZERO,
    }
}
