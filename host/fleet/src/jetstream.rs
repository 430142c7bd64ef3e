//! Streams, consumers and buckets on the server, made by `ihd-fleet init`, with their limits (docs/fleet.md).

use std::collections::BTreeMap;
use std::time::Duration;

use async_nats::StatusCode;
use async_nats::jetstream::consumer::{AckPolicy, pull};
use async_nats::jetstream::context::CreateStreamErrorKind;
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::response::Response;
use async_nats::jetstream::stream::{self, DiscardPolicy, RetentionPolicy, StorageType};
use async_nats::jetstream::{Context, kv, object_store};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};
use serde::{Deserialize, Serialize};

use crate::access::TIMEOUT;
use crate::clock::now_ms;
use crate::names;

/// A day.
const DAY: Duration = Duration::from_secs(86_400);

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

/// Values of a bucket that are read at a time.
const READ_AT_A_TIME: usize = 64;

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

/// Error of the server or of an object on it.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {why}")]
pub struct JetStreamError {
    /// Name of the stream, bucket or consumer.
    pub what: String,
    /// Error text.
    pub why: String,
}

impl JetStreamError {
    /// Creates it from an error of the client.
    pub fn new(what: &str, why: impl std::fmt::Display) -> Self {
        Self {
            what: what.to_owned(),
            why: why.to_string(),
        }
    }
}

fn failed<E: std::fmt::Display>(what: &str) -> impl FnOnce(E) -> JetStreamError + '_ {
    move |why| JetStreamError::new(what, why)
}

impl FleetLimits {
    fn streams(&self) -> [stream::Config; 4] {
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
    fn buckets(&self) -> [stream::Config; 7] {
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

    fn captures(&self) -> object_store::Config {
        object_store::Config {
            bucket: names::CAPTURES.to_owned(),
            max_bytes: self.captures_bytes,
            num_replicas: usize::from(self.replicas),
            ..object_store::Config::default()
        }
    }

    /// Returns the consumer that all workers share. The server redelivers without limit; the worker that gets a window for the sixth
    /// time makes it a dead letter, so that none gets stuck.
    fn workers(&self) -> pull::Config {
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

/// Makes the consumer of an edge's results, which the edge's own key may not do (docs/fleet.md).
///
/// # Errors
/// [`JetStreamError`].
pub async fn init_edge(
    context: &Context,
    edge: &str,
    hobs: &[String],
) -> Result<(), JetStreamError> {
    let config = edge_consumer(edge, hobs);
    let made = context.create_consumer_on_stream(config, names::RESULTS);
    made.await.map(drop).map_err(failed(names::RESULTS))
}

/// Returns the limits of the last [`init`]; `None` on a server without a fleet.
///
/// # Errors
/// [`JetStreamError`] if they cannot be read.
pub async fn limits(context: &Context) -> Result<Option<FleetLimits>, JetStreamError> {
    let settings = match context.get_key_value(names::SETTINGS).await {
        Ok(settings) => settings,
        Err(e) if e.to_string().contains("not found") => return Ok(None),
        Err(e) if e.to_string().contains("timed out") => {
            return Err(JetStreamError::new(names::SETTINGS, NO_JETSTREAM));
        }
        Err(e) => return Err(JetStreamError::new(names::SETTINGS, e)),
    };
    let text = settings
        .get(LIMITS)
        .await
        .map_err(failed(names::SETTINGS))?;
    let read = |text: Bytes| {
        serde_json::from_slice(&text).map_err(|e| {
            let why = format!("its limits cannot be read, which a later ihd has set: {e}");
            JetStreamError::new(names::SETTINGS, why)
        })
    };
    text.map(read).transpose()
}

/// Refuses a limit of a stream that would delete what it holds.
async fn check_room(context: &Context, config: &stream::Config) -> Result<(), JetStreamError> {
    let Ok(there) = context.get_stream(&config.name).await else {
        return Ok(());
    };
    let state = &there.cached_info().state;
    let most = u64::try_from(config.max_bytes).unwrap_or(u64::MAX);
    if state.messages > 0 && state.bytes > most {
        let why = format!(
            "it holds {} bytes, more than the {most} that it is to have: `init` deletes nothing",
            state.bytes
        );
        return Err(JetStreamError::new(&config.name, why));
    }
    let days = config.max_age.as_secs() / DAY.as_secs();
    let first_s = state.first_timestamp.unix_timestamp();
    let age_s = u64::try_from(now_ms() / 1_000 - first_s).unwrap_or(0);
    let becomes_shorter = there.cached_info().config.max_age > config.max_age;
    if state.messages > 0 && becomes_shorter && days > 0 && age_s > config.max_age.as_secs() {
        let why = format!(
            "its first message is {} days old, more than the {days} that it is to have: `init` deletes nothing",
            age_s / DAY.as_secs()
        );
        return Err(JetStreamError::new(&config.name, why));
    }
    Ok(())
}

/// Makes missing streams, buckets and consumers and applies the limits to existing ones. No data is deleted: a limit below what is there is
/// refused before anything is changed.
///
/// # Errors
/// [`JetStreamError`] with the name of the refused object.
pub async fn init(context: &Context, limits: &FleetLimits) -> Result<(), JetStreamError> {
    for config in &limits.streams() {
        check_room(context, config).await?;
    }
    let captures = context.get_stream(names::CAPTURES_STREAM).await;
    let captures = captures.ok().map(|captures| stream::Config {
        max_bytes: limits.captures_bytes,
        num_replicas: usize::from(limits.replicas),
        ..captures.cached_info().config.clone()
    });
    if let Some(config) = &captures {
        check_room(context, config).await?;
    }
    for config in limits.streams() {
        let name = config.name.clone();
        let made = context.create_or_update_stream(config).await;
        made.map_err(|e| match e.kind() {
            CreateStreamErrorKind::TimedOut => JetStreamError::new(&name, NO_JETSTREAM),
            _ => JetStreamError::new(&name, e),
        })?;
    }
    let windows = context.get_stream_no_info(names::WINDOWS).await;
    let windows = windows.map_err(failed(names::WINDOWS))?;
    // Its filter overlaps with the present one, and its workers would give up windows of a later version.
    let _ = windows.delete_consumer(names::WORKERS_1).await;
    let workers = windows.create_consumer(limits.workers()).await;
    workers.map_err(failed(names::WORKERS))?;
    for config in limits.buckets() {
        let name = config.name.clone();
        let made = context.create_or_update_stream(config).await;
        made.map_err(failed(&name))?;
    }
    match captures {
        Some(config) => {
            let made = context.update_stream(config).await;
            made.map(drop).map_err(failed(names::CAPTURES))?;
        }
        None => {
            let made = context.create_object_store(limits.captures()).await;
            made.map(drop).map_err(failed(names::CAPTURES))?;
        }
    }
    let settings = bucket(context, names::SETTINGS).await?;
    let text = serde_json::to_vec(limits).unwrap_or_default();
    let put = settings.put(LIMITS, text.into()).await;
    put.map_err(failed(names::SETTINGS))?;
    Ok(())
}

/// Key of the settings: [`FleetLimits`].
const LIMITS: &str = "limits";

const NO_JETSTREAM: &str =
    "the server does not answer for JetStream: is it started with -js, and may this user use it?";

/// Opens a bucket of the fleet.
///
/// # Errors
/// [`JetStreamError`]; a missing bucket is made by `ihd-fleet init`.
pub async fn bucket(context: &Context, name: &str) -> Result<kv::Store, JetStreamError> {
    let store = context.get_key_value(name).await;
    store.map_err(|e| missing(name, e))
}

/// Puts a key's value without a condition, in a single publication.
///
/// # Errors
/// As [`bucket`].
pub(crate) async fn put(
    context: &Context,
    bucket: &str,
    key: &str,
    value: Vec<u8>,
) -> Result<(), JetStreamError> {
    let sent = context.publish(names::key(bucket, key), value.into()).await;
    let sent = sent.map_err(|e| missing(bucket, e))?;
    sent.await.map(drop).map_err(|e| missing(bucket, e))
}

/// Removes a key, as [`put`].
///
/// # Errors
/// As [`bucket`].
pub(crate) async fn remove(
    context: &Context,
    bucket: &str,
    key: &str,
) -> Result<(), JetStreamError> {
    let mut headers = async_nats::HeaderMap::new();
    headers.insert("KV-Operation", "DEL");
    let subject = names::key(bucket, key);
    let sent = context.publish_with_headers(subject, headers, Bytes::new());
    let sent = sent.await.map_err(|e| missing(bucket, e))?;
    sent.await.map(drop).map_err(|e| missing(bucket, e))
}

/// Value of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BucketEntry {
    /// The value.
    pub value: Bytes,
    /// Time since it was put, by the server's clock, in milliseconds.
    pub age_ms: i64,
}

/// Keys of a bucket, as the server lists them.
#[derive(Deserialize)]
struct KeyList {
    /// Time of the server.
    ts: jiff::Timestamp,
    state: KeyCounts,
    /// Number of all keys.
    #[serde(default)]
    total: usize,
}

#[derive(Deserialize)]
struct KeyCounts {
    #[serde(default)]
    subjects: BTreeMap<String, u64>,
}

/// Returns the values of a bucket by key: the keys that it had at the start, several read at a time, so that no writer is chased and a
/// far server is not asked one question after the other. Reads each with the right to list a bucket.
///
/// # Errors
/// As [`bucket`].
pub async fn entries(
    context: &Context,
    name: &str,
) -> Result<BTreeMap<String, BucketEntry>, JetStreamError> {
    let stream = names::bucket_stream(name);
    let filter = serde_json::json!({ "subjects_filter": names::key(name, ">") });
    let listed = context.request(format!("STREAM.INFO.{stream}"), &filter);
    let listed = listed.await.map_err(|e| missing(name, e))?;
    let KeyList { ts, state, total } = match listed {
        Response::Ok(listed) => listed,
        Response::Err { error } => return Err(missing(name, error)),
    };
    if total > state.subjects.len() {
        let why = format!("{total} keys are more than can be read");
        return Err(JetStreamError::new(name, why));
    }
    let prefix = names::key(name, "");
    let reading = state.subjects.into_keys().map(|subject| {
        let (context, stream, prefix) = (context.clone(), stream.clone(), prefix.clone());
        async move {
            let message = last_message(&context, &stream, &subject).await?;
            let message = message.filter(|m| m.headers.get("KV-Operation").is_none());
            Ok::<_, String>(message.map(|message| {
                let key = subject.strip_prefix(&prefix).unwrap_or_default();
                let at_ms = message.time.unix_timestamp_nanos() / 1_000_000;
                let age_ms = ts.as_millisecond() - i64::try_from(at_ms).unwrap_or(0);
                let entry = BucketEntry {
                    value: message.payload,
                    // 0: put after the list.
                    age_ms: age_ms.max(0),
                };
                (key.to_owned(), entry)
            }))
        }
    });
    let read = futures_util::stream::iter(reading).buffer_unordered(READ_AT_A_TIME);
    let read: Result<Vec<_>, String> = read.try_collect().await;
    let read = read.map_err(|why| missing(name, why))?;
    Ok(read.into_iter().flatten().collect())
}

/// Returns the last message of a subject; `None` without one. The subject is in the request, which the right to list a bucket allows.
async fn last_message(
    context: &Context,
    stream: &str,
    subject: &str,
) -> Result<Option<StreamMessage>, String> {
    let payload = serde_json::json!({ "last_by_subj": subject }).to_string();
    let request = async_nats::Request::new()
        .payload(payload.into())
        .timeout(Some(TIMEOUT));
    let client = context.client();
    let to = format!("$JS.API.DIRECT.GET.{stream}");
    let answer = client.send_request(to, request).await;
    let answer = answer.map_err(|e| e.to_string())?;
    match answer.status {
        Some(StatusCode::NOT_FOUND) => Ok(None),
        Some(status) if status != StatusCode::OK => {
            let why = answer.description.unwrap_or_default();
            Err(format!("{status} {why}"))
        }
        _ => StreamMessage::try_from(answer)
            .map(Some)
            .map_err(|e| e.to_string()),
    }
}

/// Opens a stream of the fleet.
///
/// # Errors
/// As [`bucket`].
pub async fn stream(context: &Context, name: &str) -> Result<stream::Stream, JetStreamError> {
    let stream = context.get_stream(name).await;
    stream.map_err(|e| missing(name, e))
}

/// Returns the error of an object that `ihd-fleet init` makes.
pub(crate) fn missing(name: &str, why: impl std::fmt::Display) -> JetStreamError {
    let why = why.to_string();
    match why.contains("not found") {
        true => JetStreamError::new(
            name,
            "the server has none: `ihd-fleet init --url …` makes what a fleet needs",
        ),
        false => JetStreamError::new(name, why),
    }
}
