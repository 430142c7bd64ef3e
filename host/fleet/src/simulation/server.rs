//! The server's memory: streams, the consumer of the edge and that of the workers, with the rules of JetStream that the fleet relies on.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use async_nats::HeaderMap;
use bytes::Bytes;

use crate::engine::{ACK_WAIT, DUPLICATES_WITHIN};
use crate::names;
use crate::server::{Acknowledged, Outgoing, PublishTrouble};

/// A message that is kept.
#[derive(Clone, Debug)]
pub struct Message {
    /// Its subject.
    pub subject: String,
    /// Its headers.
    pub headers: HeaderMap,
    /// Its bytes.
    pub payload: Bytes,
}

/// A stream.
#[derive(Default)]
pub struct Stream {
    /// Number of the last message that ever came.
    last: u64,
    /// Messages by number.
    pub messages: BTreeMap<u64, Message>,
    /// Numbers of messages by that of their senders, and when they came.
    known: BTreeMap<String, (u64, Duration)>,
}

impl Stream {
    /// The last message of a subject, with its number.
    pub fn last_of(&self, subject: &str) -> Option<(u64, &Message)> {
        let found = self
            .messages
            .iter()
            .rev()
            .find(|(_, m)| m.subject == subject);
        found.map(|(number, message)| (*number, message))
    }

    fn put(
        &mut self,
        now: Duration,
        message: Outgoing,
        one_a_subject: bool,
    ) -> Result<Acknowledged, PublishTrouble> {
        self.known
            .retain(|_, (_, at)| now - *at < DUPLICATES_WITHIN);
        let known = message.number.as_ref().and_then(|n| self.known.get(n));
        if let Some((number, _)) = known {
            return Ok(Acknowledged {
                number: *number,
                is_duplicate: true,
            });
        }
        let before = self
            .last_of(&message.subject)
            .map_or(0, |(number, _)| number);
        if message.after.is_some_and(|after| after != before) {
            return Err(PublishTrouble::Occupied);
        }
        if one_a_subject {
            self.messages.remove(&before);
        }
        self.last += 1;
        let number = self.last;
        self.known
            .extend(message.number.map(|n| (n, (number, now))));
        self.messages.insert(
            number,
            Message {
                subject: message.subject,
                headers: HeaderMap::new(),
                payload: message.payload,
            },
        );
        Ok(Acknowledged {
            number,
            is_duplicate: false,
        })
    }
}

/// A consumer that acknowledges each message.
#[derive(Default)]
pub struct Consumer {
    /// When it was made, in microseconds.
    pub made_us: i64,
    /// Number of the last message that was given for the first time.
    given: u64,
    /// Messages that were given and not acknowledged: when they are given again, and how often they were.
    pending: BTreeMap<u64, (Duration, u32)>,
}

impl Consumer {
    /// One that is made now.
    pub fn new(now: Duration) -> Self {
        Self {
            made_us: i64::try_from(now.as_micros()).unwrap_or(i64::MAX),
            ..Self::default()
        }
    }

    /// Gives messages of a stream, at most so many, each with how often it was given.
    pub fn give(
        &mut self,
        now: Duration,
        stream: &Stream,
        most: usize,
    ) -> Vec<(u64, Message, u32)> {
        self.pending
            .retain(|number, _| stream.messages.contains_key(number));
        let again = self.pending.iter().filter(|(_, (at, _))| *at <= now);
        let again: Vec<u64> = again.map(|(number, _)| *number).collect();
        let new = stream.messages.range(self.given + 1..).map(|(n, _)| *n);
        let numbers: Vec<u64> = again.into_iter().chain(new).take(most).collect();
        let give = |number: u64| {
            self.given = self.given.max(number);
            let (at, times) = self.pending.entry(number).or_default();
            (*at, *times) = (now + ACK_WAIT, *times + 1);
            (number, stream.messages[&number].clone(), *times)
        };
        numbers.into_iter().map(give).collect()
    }

    /// One of them is done with.
    pub fn ack(&mut self, number: u64) {
        self.pending.remove(&number);
    }

    /// One of them is given again at that time.
    pub fn again_at(&mut self, number: u64, at: Duration) {
        if let Some((again_at, _)) = self.pending.get_mut(&number) {
            *again_at = at;
        }
    }

    /// All that are given are given again, acknowledged or not, as after a restart that has forgotten the last of them.
    fn forget(&mut self, now: Duration) {
        self.given = self.given.saturating_sub(3);
        for (at, _) in self.pending.values_mut() {
            *at = now;
        }
    }
}

/// Content of the server's disk.
#[derive(Default)]
pub struct Disk {
    streams: BTreeMap<String, Stream>,
    /// The consumer of the edge, once it was made.
    pub results: Option<Consumer>,
    /// The consumer of the workers.
    pub windows: Consumer,
    /// Disks before this one. An acknowledgement of what one of those gave is nobody's.
    pub before: u32,
}

impl Disk {
    /// A stream of this name.
    pub fn stream(&mut self, name: &str) -> &mut Stream {
        self.streams.entry(name.to_owned()).or_default()
    }

    /// Publishes a message.
    pub fn publish(
        &mut self,
        now: Duration,
        message: Outgoing,
    ) -> Result<Acknowledged, PublishTrouble> {
        let (stream, one_a_subject) = stream_of(&message.subject);
        self.stream(&stream).put(now, message, one_a_subject)
    }

    /// Gives windows to a worker.
    pub fn give_windows(&mut self, now: Duration, most: usize) -> Vec<(u64, Message, u32)> {
        let stream = self.streams.entry(names::WINDOWS.to_owned()).or_default();
        self.windows.give(now, stream, most)
    }

    /// Gives results to the edge; none where there is no consumer.
    pub fn give_results(&mut self, now: Duration, most: usize) -> Option<Vec<(u64, Message, u32)>> {
        let stream = self.streams.entry(names::RESULTS.to_owned()).or_default();
        Some(self.results.as_mut()?.give(now, stream, most))
    }

    /// All is lost.
    pub fn lose(&mut self) {
        *self = Self {
            before: self.before + 1,
            ..Self::default()
        };
    }

    /// The server starts again.
    pub fn restart(&mut self, now: Duration) {
        self.windows.forget(now);
        if let Some(results) = &mut self.results {
            results.forget(now);
        }
    }
}

/// Stream of a subject, and whether it keeps one message of each.
fn stream_of(subject: &str) -> (String, bool) {
    let kind = subject.split('.').nth(3);
    match kind {
        Some("window") => (names::WINDOWS.to_owned(), false),
        Some("result") => (names::RESULTS.to_owned(), true),
        Some("dead") => (names::DEAD.to_owned(), true),
        Some("event") => (names::EVENTS.to_owned(), false),
        _ => {
            let bucket = subject.split('.').nth(1).unwrap_or_default();
            (names::bucket_stream(bucket), true)
        }
    }
}

/// The server. It outlives the daemons.
#[derive(Default)]
pub struct Memory(Mutex<Disk>);

impl Memory {
    /// An empty one.
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// Its disk.
    pub fn disk(&self) -> MutexGuard<'_, Disk> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
