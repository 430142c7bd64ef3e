//! Simulated server: streams and the consumers of edge and workers, with the rules of JetStream that the fleet relies on.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use async_nats::HeaderMap;
use bytes::Bytes;
use ihd_daemon::locking::lock;

use crate::jetstream::{ACK_WAIT, DUPLICATES_WITHIN};
use crate::names;
use crate::stream_message::{Acknowledged, Outgoing, PublishFailure};

/// Stored message.
#[derive(Clone, Debug)]
pub struct StreamEntry {
    /// Its subject.
    pub subject: String,
    /// Its headers.
    pub headers: HeaderMap,
    /// Its bytes.
    pub payload: Bytes,
}

/// A stream.
#[derive(Default)]
pub struct MessageStream {
    /// Number of the last message ever stored.
    last: u64,
    /// Messages by number.
    pub messages: BTreeMap<u64, StreamEntry>,
    /// Numbers and times of messages by message id.
    known: BTreeMap<String, (u64, Duration)>,
}

impl MessageStream {
    /// Returns the last message of a subject, with its number.
    pub fn last_of(&self, subject: &str) -> Option<(u64, &StreamEntry)> {
        let last = self
            .messages
            .iter()
            .rev()
            .find(|(_, m)| m.subject == subject);
        last.map(|(number, message)| (*number, message))
    }

    fn put(
        &mut self,
        now: Duration,
        message: Outgoing,
        one_a_subject: bool,
    ) -> Result<Acknowledged, PublishFailure> {
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
            return Err(PublishFailure::Occupied);
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
            StreamEntry {
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

/// Consumer with an acknowledgement of each message.
#[derive(Default)]
pub struct Consumer {
    /// Time of its creation in microseconds.
    pub made_us: i64,
    /// Number of the last message delivered for the first time.
    given: u64,
    /// Unacknowledged messages: time of the redelivery, number of deliveries.
    pending: BTreeMap<u64, (Duration, u32)>,
}

impl Consumer {
    /// Creates a consumer.
    pub fn new(now: Duration) -> Self {
        Self {
            made_us: i64::try_from(now.as_micros()).unwrap_or(i64::MAX),
            ..Self::default()
        }
    }

    /// Delivers up to `most` messages of a stream, each with its number of deliveries.
    pub fn give(
        &mut self,
        now: Duration,
        stream: &MessageStream,
        most: usize,
    ) -> Vec<(u64, StreamEntry, u32)> {
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

    /// Acknowledges a message.
    pub fn ack(&mut self, number: u64) {
        self.pending.remove(&number);
    }

    /// Sets the time of a redelivery.
    pub fn again_at(&mut self, number: u64, at: Duration) {
        if let Some((again_at, _)) = self.pending.get_mut(&number) {
            *again_at = at;
        }
    }

    /// Redelivers all pending messages and the last acknowledged ones, as after a restart that has lost the latest state.
    fn forget(&mut self, now: Duration) {
        self.given = self.given.saturating_sub(3);
        for (at, _) in self.pending.values_mut() {
            *at = now;
        }
    }
}

/// Content of the server's disk.
#[derive(Default)]
pub struct ServerDisk {
    streams: BTreeMap<String, MessageStream>,
    /// Consumer of the edge, `None` before it is made.
    pub results: Option<Consumer>,
    /// Consumer of the workers.
    pub windows: Consumer,
    /// Hobs without rights.
    pub refused: BTreeSet<String>,
    /// Number of former disks; acknowledgements of their messages are ignored.
    pub before: u32,
}

impl ServerDisk {
    /// Returns the stream of a name.
    pub fn stream(&mut self, name: &str) -> &mut MessageStream {
        self.streams.entry(name.to_owned()).or_default()
    }

    /// Publishes a message.
    pub fn publish(
        &mut self,
        now: Duration,
        message: Outgoing,
    ) -> Result<Acknowledged, PublishFailure> {
        let hob = message.subject.split('.').nth(2);
        if hob.is_some_and(|hob| self.refused.contains(hob)) {
            return Err(PublishFailure::Other("no responders".to_owned()));
        }
        let (stream, one_a_subject) = stream_of(&message.subject);
        self.stream(&stream).put(now, message, one_a_subject)
    }

    /// Delivers windows to a worker.
    pub fn give_windows(&mut self, now: Duration, most: usize) -> Vec<(u64, StreamEntry, u32)> {
        let stream = self.streams.entry(names::WINDOWS.to_owned()).or_default();
        self.windows.give(now, stream, most)
    }

    /// Delivers results to the edge; `None` without a consumer.
    pub fn give_results(
        &mut self,
        now: Duration,
        most: usize,
    ) -> Option<Vec<(u64, StreamEntry, u32)>> {
        let stream = self.streams.entry(names::RESULTS.to_owned()).or_default();
        Some(self.results.as_mut()?.give(now, stream, most))
    }

    /// Loses all data.
    pub fn lose(&mut self) {
        *self = Self {
            before: self.before + 1,
            ..Self::default()
        };
    }

    /// Restarts the server.
    pub fn restart(&mut self, now: Duration) {
        self.windows.forget(now);
        if let Some(results) = &mut self.results {
            results.forget(now);
        }
    }
}

/// Returns the stream of a subject, and `true` if it stores one message of each subject.
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

/// Memory of the server; it outlives the daemons.
#[derive(Default)]
pub struct ServerMemory(Mutex<ServerDisk>);

impl ServerMemory {
    /// Creates an empty memory.
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// Returns its disk.
    pub fn disk(&self) -> MutexGuard<'_, ServerDisk> {
        lock(&self.0)
    }
}
