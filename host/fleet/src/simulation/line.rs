//! The line between an edge and the server: what passes, what is lost, and how long it takes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use async_nats::jetstream::AckKind;
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::{self, BoxStream};
use ihd_daemon::simulation::World;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::{Instant, sleep};

use super::server::{Consumer, Memory, Message};
use crate::edge::{State, lock};
use crate::engine::EngineError;
use crate::names;
use crate::server::{Acknowledged, Incoming, Kept, Outgoing, PublishTrouble, UnderWay};

/// Longest wait of the client for an answer (crate::access).
const WITHIN: Duration = Duration::from_secs(5);

/// Step in which somebody waits.
const STEP: Duration = Duration::from_millis(50);

/// Hob, boot and number of a window.
pub type Key = (String, u32, u32);

/// Condition of line and server. It ends with the life of the daemon.
pub struct Weather {
    /// Nothing passes until then.
    pub stalled_until: Instant,
    /// The queue takes no window until then.
    pub full_until: Instant,
    /// The server has no streams until then.
    pub bare_until: Instant,
    /// Chance that an acknowledgement, either way, is lost.
    pub lost: f64,
    /// Chance that a message is late.
    pub late: f64,
}

/// News that the edge has had of the server in this life.
#[derive(Default)]
pub struct Heard {
    /// The last answer to anything.
    pub last: Option<Instant>,
    /// Windows of which it has heard that they are in the queue, and when; without those whose result came.
    pub waited_for: BTreeMap<Key, Instant>,
}

/// The line.
#[derive(Clone)]
pub struct Line {
    /// The world.
    pub world: Arc<World>,
    /// The server.
    pub memory: Arc<Memory>,
    /// The edge's own record of its connection.
    pub edge: Arc<Mutex<State>>,
    weather: Arc<Mutex<Weather>>,
    heard: Arc<Mutex<Heard>>,
    rng: Arc<Mutex<ChaCha8Rng>>,
}

impl Line {
    /// Line of a life that begins.
    pub fn new(world: Arc<World>, memory: Arc<Memory>, edge: Arc<Mutex<State>>, seed: u64) -> Self {
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
            heard: Arc::default(),
            rng: Arc::new(Mutex::new(ChaCha8Rng::seed_from_u64(seed))),
        }
    }

    /// Condition of line and server.
    pub fn weather(&self) -> MutexGuard<'_, Weather> {
        lock(&self.weather)
    }

    /// News that the edge has had.
    pub fn heard(&self) -> MutexGuard<'_, Heard> {
        lock(&self.heard)
    }

    fn is(&self, until: impl Fn(&Weather) -> Instant) -> bool {
        self.world.may_fail() && Instant::now() < until(&self.weather())
    }

    /// Nothing passes.
    pub fn is_stalled(&self) -> bool {
        self.is(|weather| weather.stalled_until)
    }

    /// True with this chance, where something may fail.
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

    /// Asks the server for something; the client gives up after a while.
    async fn ask<T>(&self, answer: impl FnOnce() -> T) -> Result<T, String> {
        let asked = Instant::now();
        let passed = tokio::time::timeout(WITHIN, self.pass()).await;
        if passed.is_err() || self.happens(|weather| weather.lost) {
            let rest = WITHIN.saturating_sub(asked.elapsed());
            sleep(rest).await;
            return Err("timed out".to_owned());
        }
        if self.is(|weather| weather.bare_until) {
            return Err("stream not found".to_owned());
        }
        self.heard().last = Some(Instant::now());
        Ok(answer())
    }

    /// Sends a message. While nothing passes the client keeps it, or has no room and waits.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn publish(&self, message: Outgoing) -> Result<UnderWay, PublishTrouble> {
        if self.is_stalled() && self.happens(|_| 0.2) {
            self.pass().await;
        }
        let (line, key) = (self.clone(), window_of(&message));
        let sends = self.clone();
        // It goes on when nobody waits for it any more.
        let sent = tokio::spawn(async move { sends.send(message).await });
        Ok(Box::pin(async move {
            let answer = match tokio::time::timeout(WITHIN, sent).await {
                Ok(Ok(answer)) => answer?,
                Ok(Err(_)) | Err(_) => return Err(PublishTrouble::Other("timed out".to_owned())),
            };
            let (mut heard, now) = (line.heard(), Instant::now());
            heard.last = Some(now);
            if let Some(key) = key {
                heard.waited_for.insert(key, now);
            }
            Ok(answer)
        }))
    }

    async fn send(&self, message: Outgoing) -> Result<Acknowledged, PublishTrouble> {
        let began_stalled = self.is_stalled();
        self.pass().await;
        if began_stalled && self.happens(|_| 0.3) {
            // With the connection that it was on.
            return std::future::pending().await;
        }
        if self.happens(|weather| weather.late) {
            sleep(self.milliseconds(1_000..30_000)).await;
        }
        if self.is(|weather| weather.bare_until) {
            let why = "no stream found for given subject".to_owned();
            return Err(PublishTrouble::Other(why));
        }
        let is_window = window_of(&message).is_some();
        if is_window && self.is(|weather| weather.full_until) {
            let why = "maximum bytes exceeded".to_owned();
            return Err(PublishTrouble::Other(why));
        }
        let now = self.world.now();
        let answer = self.memory.disk().publish(now, message);
        if self.happens(|weather| weather.lost) {
            return std::future::pending().await;
        }
        answer
    }

    /// The last message of a subject.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn last(&self, stream: &str, subject: &str) -> Result<Option<Kept>, String> {
        let look = || {
            let mut disk = self.memory.disk();
            let found = disk.stream(stream).last_of(subject);
            found.map(|(number, message)| Kept {
                number,
                headers: message.headers.clone(),
                payload: message.payload.clone(),
            })
        };
        let found = self.ask(look).await?;
        if found.is_some()
            && let Some(key) = dead_window(subject)
        {
            self.heard().waited_for.remove(&key);
        }
        Ok(found)
    }

    /// Finds or makes the consumer of the edge.
    ///
    /// # Errors
    /// The client gives up.
    pub async fn results(&self) -> Result<Results, EngineError> {
        let find = || {
            let now = self.world.now();
            let mut disk = self.memory.disk();
            disk.results
                .get_or_insert_with(|| Consumer::new(now))
                .made_us
        };
        let made_us = self.ask(find).await;
        let made_us = made_us.map_err(|e| EngineError::new(names::RESULTS, e))?;
        let line = self.clone();
        Ok(Results { line, made_us })
    }
}

/// The window that a message to the queue is of.
fn window_of(message: &Outgoing) -> Option<Key> {
    let read = crate::wire::WindowMessage::from_bytes(&message.payload).ok()?;
    Some((read.hob, read.boot, read.window.seq))
}

/// The window that a subject of the dead is of.
fn dead_window(subject: &str) -> Option<Key> {
    let result = subject.replace(".dead.", ".result.");
    names::window_of_result(&result).filter(|_| result != subject)
}

/// The edge's consumer.
pub struct Results {
    line: Line,
    made_us: i64,
}

impl Results {
    /// When it was made.
    pub fn made_us(&self) -> i64 {
        self.made_us
    }

    fn is_there(&self) -> bool {
        let disk = self.line.memory.disk();
        let made_us = disk.results.as_ref().map(|consumer| consumer.made_us);
        made_us == Some(self.made_us)
    }

    /// Waits for results; for ever where the answer is lost.
    ///
    /// # Errors
    /// None of its own.
    pub async fn fetch(
        &self,
        most: usize,
        wait: Duration,
    ) -> Result<BoxStream<'static, Result<Incoming, String>>, String> {
        let line = &self.line;
        // The client ends a request that nobody answers 5 s after its time.
        let deadline = Instant::now() + wait + WITHIN;
        if tokio::time::timeout_at(deadline, line.pass())
            .await
            .is_err()
        {
            return Ok(stream::empty().boxed());
        }
        if !self.is_there() {
            // Nobody hears the request.
            return Ok(stream::iter([Err("no responders".to_owned())]).boxed());
        }
        let expires = Instant::now() + wait;
        loop {
            let now = line.world.now();
            let Some(given) = line.memory.disk().give_results(now, most) else {
                return Ok(stream::iter([Err("consumer deleted".to_owned())]).boxed());
            };
            if line.is_stalled() || line.happens(|weather| weather.lost) {
                // Given, and never heard of: they come again after their time.
                tokio::time::sleep_until(deadline).await;
                return Ok(stream::empty().boxed());
            }
            if !given.is_empty() || Instant::now() >= expires {
                line.heard().last = Some(Instant::now());
                let made_us = self.made_us;
                let of = |(number, message, _)| {
                    let line = line.clone();
                    Ok(Incoming::Simulated(Delivered {
                        line,
                        made_us,
                        number,
                        message,
                    }))
                };
                let given: Vec<_> = given.into_iter().map(of).collect();
                return Ok(stream::iter(given).boxed());
            }
            sleep(2 * STEP).await;
        }
    }
}

/// A result that was given to the edge.
pub struct Delivered {
    line: Line,
    /// Making of the consumer that gave it, in microseconds.
    made_us: i64,
    number: u64,
    message: Message,
}

impl Delivered {
    /// Its subject.
    pub fn subject(&self) -> &str {
        &self.message.subject
    }

    /// Its bytes.
    pub fn payload(&self) -> &Bytes {
        &self.message.payload
    }

    /// Tells the server what became of it; where nothing passes, nobody hears of it.
    pub async fn settle(&self, kind: AckKind) {
        let line = &self.line;
        if matches!(kind, AckKind::Ack)
            && let Some(key) = names::window_of_result(self.subject())
        {
            line.heard().waited_for.remove(&key);
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
