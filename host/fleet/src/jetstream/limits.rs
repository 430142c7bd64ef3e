//! Limits of a fleet, and the streams, buckets and consumers that follow from them.

use std::time::Duration;

use async_nats::jetstream::consumer::{AckPolicy, pull};
use async_nats::jetstream::object_store;
use async_nats::jetstream::stream::{self, DiscardPolicy, RetentionPolicy, StorageType};
use serde::{Deserialize, Serialize};

use crate::names;

/// A day.
pub(super) const DAY: Duration = Duration::from_secs(86_400);

/// Time after which a window without acknowledgement goes to another worker; a working worker extends it.
pub const ACK_WAIT: Duration = Duration::from_secs(30);

/// Deliveries of a window after which it is given up.
pub const MAX_DELIVERIES: i64 = 5;

/// Deliveries after which a window is given up that some workers leave to others: each time that one of them passes it on, every 10 s, counts.
pub const MAX_PASSED_ON: i64 = 500;

/// Windows for each thread of a worker: one in progress, one waiting.
pub const PER_THREAD: usize = 2;

/// Time within which the server detects a duplicate window. A later duplicate only costs a worker's time: a result is unique by its
/// subject.
pub const DUPLICATES_WITHIN: Duration = Duration::from_secs(3_600);

/// Time after which the entry of an edge or a worker expires unless it is renewed.
pub const SILENT_AFTER: Duration = Duration::from_secs(30);

/// Time after which the entry of a hob expires that no edge renews.
const HOB_GONE_AFTER: Duration = Duration::from_secs(7 * 86_400);

/// Longest time within which the server detects a value that was put twice.
const MAX_BUCKET_DUPLICATES: Duration = Duration::from_secs(120);

/// Largest value in a bucket, in bytes: the pots of a hob.
const MAX_VALUE: i32 = 1 << 18;

/// Limits of the fleet on the server. Windows beyond their limit are refused, so that edges keep them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FleetLimits {
    /// Bytes of windows that wait for a worker.
    pub windows_bytes: i64,
    /// Waiting windows of one hob, so that no hob fills the queue.
    pub windows_of_a_hob: i64,
    /// Longest wait of a window in days.
    pub windows_days: u32,
    /// Bytes of results; the oldest are deleted first. An edge that missed one sends its window again after a day.
    pub results_bytes: i64,
    /// Days that results are kept: within them an edge may be offline without any window being identified twice.
    pub results_days: u32,
    /// Bytes of events; the oldest are deleted first.
    pub events_bytes: i64,
    /// Bytes of windows that were given up.
    pub dead_bytes: i64,
    /// Bytes of captures.
    pub captures_bytes: i64,
    /// Lookups in the history of a hob, 1 to 64.
    pub lookups: u8,
    /// Threads of all workers; twice as many windows may be in progress.
    pub threads: u32,
    /// Copies of everything, 1, 3 or 5 (a cluster).
    pub replicas: u8,
}

impl Default for FleetLimits {
    fn default() -> Self {
        Self {
            windows_bytes: 4_000_000_000,
            windows_of_a_hob: 100_000,
            windows_days: 30,
            results_bytes: 2_000_000_000,
            results_days: 30,
            events_bytes: 200_000_000,
            dead_bytes: 300_000_000,
            captures_bytes: 2_000_000_000,
            lookups: 16,
            threads: 64,
            replicas: 1,
        }
    }
}

impl FleetLimits {
    pub(super) fn streams(&self) -> [stream::Config; 4] {
        // Subjects of every version, so that waiting windows of an older one stay.
        let subject = |kind: &str| vec![format!("ihd.*.*.{kind}")];
        let base = |name: &str, subjects: Vec<String>| stream::Config {
            name: name.to_owned(),
            subjects,
            storage: StorageType::File,
            num_replicas: usize::from(self.replicas),
            duplicate_window: DUPLICATES_WITHIN,
            discard: DiscardPolicy::New,
            allow_direct: true,
            ..stream::Config::default()
        };
        let at_most = |count: i64, config: stream::Config| stream::Config {
            max_messages_per_subject: count,
            discard_new_per_subject: true,
            ..config
        };
        let once = |config| at_most(1, config);
        [
            stream::Config {
                retention: RetentionPolicy::WorkQueue,
                max_bytes: self.windows_bytes,
                max_age: DAY * self.windows_days,
                ..at_most(
                    self.windows_of_a_hob,
                    base(names::WINDOWS, subject("window")),
                )
            },
            stream::Config {
                max_bytes: self.results_bytes,
                max_age: DAY * self.results_days,
                // The first message of a subject counts: each publisher requires that the subject is empty.
                max_messages_per_subject: 1,
                discard: DiscardPolicy::Old,
                ..base(names::RESULTS, subject("result.*.*"))
            },
            stream::Config {
                max_bytes: self.events_bytes,
                discard: DiscardPolicy::Old,
                ..base(names::EVENTS, subject("event"))
            },
            stream::Config {
                max_bytes: self.dead_bytes,
                ..once(base(names::DEAD, subject("dead.*.*")))
            },
        ]
    }

    /// Returns the buckets as streams, without roll-up: with roll-up any client that may write one key could empty the bucket.
    pub(super) fn buckets(&self) -> [stream::Config; 7] {
        let bucket = |name: &str, history: i64, max_age: Duration| stream::Config {
            name: names::bucket_stream(name),
            subjects: vec![names::key(name, ">")],
            max_messages_per_subject: history,
            max_message_size: MAX_VALUE,
            max_age,
            discard: DiscardPolicy::New,
            storage: StorageType::File,
            num_replicas: usize::from(self.replicas),
            duplicate_window: match max_age.is_zero() {
                true => MAX_BUCKET_DUPLICATES,
                false => max_age.min(MAX_BUCKET_DUPLICATES),
            },
            allow_direct: true,
            deny_delete: true,
            allow_rollup: false,
            ..stream::Config::default()
        };
        let forever = Duration::ZERO;
        [
            bucket(names::LOOKUPS, i64::from(self.lookups), forever),
            bucket(names::HOBS, 1, HOB_GONE_AFTER),
            bucket(names::EDGES, 1, SILENT_AFTER),
            bucket(names::WORKER_CARDS, 1, SILENT_AFTER),
            bucket(names::POTS, 1, forever),
            bucket(names::CLAIMS, 1, forever),
            bucket(names::SETTINGS, 1, forever),
        ]
    }

    pub(super) fn captures(&self) -> object_store::Config {
        object_store::Config {
            bucket: names::CAPTURES.to_owned(),
            max_bytes: self.captures_bytes,
            num_replicas: usize::from(self.replicas),
            ..object_store::Config::default()
        }
    }

    /// Returns the consumer that all workers share. The server redelivers without limit; the worker that gets a window for the sixth
    /// time makes it a dead letter, so that none gets stuck.
    pub(super) fn workers(&self) -> pull::Config {
        pull::Config {
            durable_name: Some(names::WORKERS.to_owned()),
            filter_subject: names::window("*"),
            ack_policy: AckPolicy::Explicit,
            ack_wait: ACK_WAIT,
            max_deliver: -1,
            max_ack_pending: i64::from(self.threads.max(1)) * PER_THREAD as i64,
            ..pull::Config::default()
        }
    }
}

/// Returns the consumer of an edge: results of its hobs, redelivered until stored.
pub fn edge_consumer(edge: &str, hobs: &[String]) -> pull::Config {
    pull::Config {
        durable_name: Some(names::edge_consumer(edge)),
        filter_subjects: hobs.iter().map(names::results).collect(),
        ack_policy: AckPolicy::Explicit,
        ack_wait: ACK_WAIT,
        max_deliver: -1,
        max_ack_pending: 256,
        ..pull::Config::default()
    }
}
