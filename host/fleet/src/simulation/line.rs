//! Simulated connection of an edge to the server, with losses and delays.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use async_nats::jetstream::AckKind;
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::{self, BoxStream};
use ihd_daemon::locking::lock;
use ihd_daemon::simulation::World;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::{Instant, sleep};

use super::server::{Consumer, ServerMemory, StreamEntry};
use crate::edge::state::State;
use crate::jetstream::JetStreamError;
use crate::names;
use crate::stream_message::{Acknowledged, Outgoing, PendingAck, PublishFailure, StoredMessage};

/// Time-out of the client (crate::access).
const CLIENT_TIMEOUT: Duration = Duration::from_secs(5);

/// Step of waiting.
const STEP: Duration = Duration::from_millis(50);

/// Hob, boot and number of a window.
pub type SimulatedKey = (String, u32, u32);

/// Faults of connection and server in one life of the daemon.
pub struct Weather {
    /// Nothing passes until then.
    pub stalled_until: Instant,
    /// The queue takes no window until then.
    pub full_until: Instant,
    /// The server has no streams until then.
    pub bare_until: Instant,
    /// Probability that an acknowledgement, either way, is lost.
    pub lost: f64,
    /// Probability that a message is late.
    pub late: f64,
}

/// Answers of the server that the edge has received in this life.
#[derive(Default)]
pub struct ReceivedAnswers {
    /// Time of the last answer.
    pub last: Option<Instant>,
    /// Acknowledged windows without a result, each with the time of the acknowledgement.
    pub waited_for: BTreeMap<SimulatedKey, Instant>,
}

/// Simulated connection.
#[derive(Clone)]
pub struct SimulatedConnection {
    /// The world.
    pub world: Arc<World>,
    /// The server.
    pub memory: Arc<ServerMemory>,
    /// The edge's own record of its connection.
    pub edge: Arc<Mutex<State>>,
    weather: Arc<Mutex<Weather>>,
    received: Arc<Mutex<ReceivedAnswers>>,
    rng: Arc<Mutex<ChaCha8Rng>>,
}

impl SimulatedConnection {
    /// Creates the connection of a new life.
    pub fn new(
        world: Arc<World>,
        memory: Arc<ServerMemory>,
        edge: Arc<Mutex<State>>,
        seed: u64,
    ) -> Self {
        let now = Instant::now();
        Self {
            world,
            memory,
            edge,
            weather: Arc::new(Mutex::new(Weather {
                stalled_until: now,
                full_until: now,
                bare_until: now,
                lost: 0.0,
                late: 0.0,
            })),
            received: Arc::default(),
            rng: Arc::new(Mutex::new(ChaCha8Rng::seed_from_u64(seed))),
        }
    }

    /// Returns the faults.
    pub fn weather(&self) -> MutexGuard<'_, Weather> {
        lock(&self.weather)
    }

    /// Returns the received answers.
    pub fn received(&self) -> MutexGuard<'_, ReceivedAnswers> {
        lock(&self.received)
    }

    fn is(&self, until: impl Fn(&Weather) -> Instant) -> bool {
        self.world.may_fail() && Instant::now() < until(&self.weather())
    }

    /// Returns `true` while nothing passes.
    pub fn is_stalled(&self) -> bool {
        self.is(|weather| weather.stalled_until)
    }

    /// Returns `true` with a probability, while faults are allowed.
    fn happens(&self, chance: impl Fn(&Weather) -> f64) -> bool {
        let chance = chance(&self.weather());
        self.world.may_fail() && lock(&self.rng).random_bool(chance)
    }

    fn milliseconds(&self, range: std::ops::Range<u64>) -> Duration {
        Duration::from_millis(lock(&self.rng).random_range(range))
    }

    /// Waits while nothing passes.
    async fn pass(&self) {
        while self.is_stalled() {
            sleep(STEP).await;
        }
        sleep(self.milliseconds(1..20)).await;
    }

    /// Requests something of the server, with the client's time-out.
    async fn ask<T>(&self, answer: impl FnOnce() -> T) -> Result<T, String> {
        let asked = Instant::now();
        let passed = tokio::time::timeout(CLIENT_TIMEOUT, self.pass()).await;
        if passed.is_err() || self.happens(|weather| weather.lost) {
            let rest = CLIENT_TIMEOUT.saturating_sub(asked.elapsed());
            sleep(rest).await;
            return Err("timed out".to_owned());
        }
        if self.is(|weather| weather.bare_until) {
            return Err("stream not found".to_owned());
        }
        self.received().last = Some(Instant::now());
        Ok(answer())
    }

    /// Sends a message. While nothing passes the client keeps it, or has no room and waits.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn publish(&self, message: Outgoing) -> Result<PendingAck, PublishFailure> {
        if self.is_stalled() && self.happens(|_| 0.2) {
            self.pass().await;
        }
        let (line, key) = (self.clone(), window_of(&message));
        let sends = self.clone();
        // It continues if the caller does not wait any more.
        let sent = tokio::spawn(async move { sends.send(message).await });
        Ok(Box::pin(async move {
            let answer = match tokio::time::timeout(CLIENT_TIMEOUT, sent).await {
                Ok(Ok(answer)) => answer?,
                Ok(Err(_)) | Err(_) => return Err(PublishFailure::Other("timed out".to_owned())),
            };
            let (mut received, now) = (line.received(), Instant::now());
            received.last = Some(now);
            if let Some(key) = key {
                received.waited_for.insert(key, now);
            }
            Ok(answer)
        }))
    }

    async fn send(&self, message: Outgoing) -> Result<Acknowledged, PublishFailure> {
        let began_stalled = self.is_stalled();
        self.pass().await;
        if began_stalled && self.happens(|_| 0.3) {
            // Lost with its connection.
            return std::future::pending().await;
        }
        if self.happens(|weather| weather.late) {
            sleep(self.milliseconds(1_000..30_000)).await;
        }
        if self.is(|weather| weather.bare_until) {
            let why = "no stream found for given subject".to_owned();
            return Err(PublishFailure::Other(why));
        }
        let is_window = window_of(&message).is_some();
        if is_window && self.is(|weather| weather.full_until) {
            let why = "maximum bytes exceeded".to_owned();
            return Err(PublishFailure::Other(why));
        }
        let now = self.world.now();
        let answer = self.memory.disk().publish(now, message);
        if self.happens(|weather| weather.lost) {
            return std::future::pending().await;
        }
        answer
    }

    /// Returns the last message of a subject.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn last(&self, stream: &str, subject: &str) -> Result<Option<StoredMessage>, String> {
        let read = || {
            let mut disk = self.memory.disk();
            let last = disk.stream(stream).last_of(subject);
            last.map(|(number, message)| StoredMessage {
                number,
                headers: message.headers.clone(),
                payload: message.payload.clone(),
            })
        };
        let last = self.ask(read).await?;
        if last.is_some()
            && let Some(key) = dead_window(subject)
        {
            self.received().waited_for.remove(&key);
        }
        Ok(last)
    }

    /// Finds or makes the consumer of the edge.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn results(&self) -> Result<SimulatedConsumer, JetStreamError> {
        let find = || {
            let now = self.world.now();
            let mut disk = self.memory.disk();
            disk.results
                .get_or_insert_with(|| Consumer::new(now))
                .made_us
        };
        let made_us = self.ask(find).await;
        let made_us = made_us.map_err(|e| JetStreamError::new(names::RESULTS, e))?;
        let line = self.clone();
        Ok(SimulatedConsumer { line, made_us })
    }
}

/// Returns the window of a message to the queue.
fn window_of(message: &Outgoing) -> Option<SimulatedKey> {
    let read = crate::wire::WindowMessage::from_bytes(&message.payload).ok()?;
    Some((read.hob, read.boot, read.window.seq))
}

/// Returns the window of a dead letter's subject.
fn dead_window(subject: &str) -> Option<SimulatedKey> {
    let result = subject.replace(".dead.", ".result.");
    names::window_of_result(&result).filter(|_| result != subject)
}

/// The edge's consumer.
pub struct SimulatedConsumer {
    line: SimulatedConnection,
    made_us: i64,
}

impl SimulatedConsumer {
    /// Returns the time of its creation in microseconds.
    pub fn made_us(&self) -> i64 {
        self.made_us
    }

    fn is_there(&self) -> bool {
        let disk = self.line.memory.disk();
        let made_us = disk.results.as_ref().map(|consumer| consumer.made_us);
        made_us == Some(self.made_us)
    }

    /// Waits for results; until the client's time-out if the answer is lost.
    ///
    /// # Errors
    /// None of its own.
    pub async fn fetch(
        &self,
        most: usize,
        wait: Duration,
    ) -> Result<BoxStream<'static, Result<Delivered, String>>, String> {
        let line = &self.line;
        // The client ends an unanswered request 5 s after its duration.
        let deadline = Instant::now() + wait + CLIENT_TIMEOUT;
        if tokio::time::timeout_at(deadline, line.pass())
            .await
            .is_err()
        {
            return Ok(stream::empty().boxed());
        }
        if !self.is_there() {
            // No consumer receives the request.
            return Ok(stream::iter([Err("no responders".to_owned())]).boxed());
        }
        let expires = Instant::now() + wait;
        loop {
            let now = line.world.now();
            let Some(given) = line.memory.disk().give_results(now, most) else {
                return Ok(stream::iter([Err("consumer deleted".to_owned())]).boxed());
            };
            if line.is_stalled() || line.happens(|weather| weather.lost) {
                // Delivered and lost: redelivered after the acknowledgement time-out.
                tokio::time::sleep_until(deadline).await;
                return Ok(stream::empty().boxed());
            }
            if !given.is_empty() || Instant::now() >= expires {
                line.received().last = Some(Instant::now());
                let made_us = self.made_us;
                let of = |(number, message, _)| {
                    let line = line.clone();
                    Ok(Delivered {
                        line,
                        made_us,
                        number,
                        message,
                    })
                };
                let given: Vec<_> = given.into_iter().map(of).collect();
                return Ok(stream::iter(given).boxed());
            }
            sleep(2 * STEP).await;
        }
    }
}

/// Result delivered to the edge.
pub struct Delivered {
    line: SimulatedConnection,
    /// Creation of its consumer in microseconds.
    made_us: i64,
    number: u64,
    message: StreamEntry,
}

impl Delivered {
    /// Returns its subject.
    pub fn subject(&self) -> &str {
        &self.message.subject
    }

    /// Returns its bytes.
    pub fn payload(&self) -> &Bytes {
        &self.message.payload
    }

    /// Acknowledges it to the server; lost while nothing passes.
    pub async fn acknowledge_as(&self, kind: AckKind) {
        let line = &self.line;
        if matches!(kind, AckKind::Ack)
            && let Some(key) = names::window_of_result(self.subject())
        {
            line.received().waited_for.remove(&key);
        }
        if line.is_stalled() {
            if line.happens(|_| 0.2) {
                // The client has no room.
                line.pass().await;
            }
            return;
        }
        if line.happens(|weather| weather.lost) {
            return;
        }
        let now = line.world.now();
        let mut disk = line.memory.disk();
        let of_it = |consumer: &&mut Consumer| consumer.made_us == self.made_us;
        let Some(consumer) = disk.results.as_mut().filter(of_it) else {
            return;
        };
        match kind {
            AckKind::Nak(after) => {
                consumer.again_at(self.number, now + after.unwrap_or_default());
            }
            _ => consumer.ack(self.number),
        }
    }
}
