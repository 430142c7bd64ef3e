//! Values by key on the server.

use std::collections::BTreeMap;

use async_nats::StatusCode;
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::response::Response;
use async_nats::jetstream::{Context, kv};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};
use serde::Deserialize;

use super::error::{JetStreamError, missing};
use crate::access::TIMEOUT;
use crate::names;

/// Values of a bucket that are read at a time.
const READ_AT_A_TIME: usize = 64;

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
/// [`JetStreamError`] if the server refuses or does not answer; a missing object is made by `ihd-fleet init`.
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
/// [`JetStreamError`] if the server refuses or does not answer; a missing object is made by `ihd-fleet init`.
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
/// [`JetStreamError`] if the server refuses or does not answer; a missing object is made by `ihd-fleet init`.
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
