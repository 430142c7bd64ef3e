//! Dead letters: windows that were given up, and their way back into the queue.

use async_nats::header::NATS_MESSAGE_ID;
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::DirectGetErrorKind;
use async_nats::jetstream::{Context, Message};
use serde::Serialize;

use crate::jetstream::{self, JetStreamError};
use crate::message_ids::parse_window_id;
use crate::names;
use crate::server::FleetServer;

/// Headers of a window that was given up.
pub(crate) const WHY: &str = "Ihd-Why";
pub(crate) const BY: &str = "Ihd-By";

/// Longest reason, in bytes: headers are short.
const MAX_REASON_BYTES: usize = 500;

/// A window that was given up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeadWindow {
    /// Its number among the dead.
    pub number: u64,
    /// The hob's name.
    pub hob: String,
    /// The hob's boot, 0 if it could not be read.
    pub boot: u64,
    /// The window's number; that of the message in the queue if the boot could not be read.
    pub seq: u64,
    /// Time in seconds since 1970, UTC.
    pub at_s: i64,
    /// Name of the worker.
    pub by: String,
    /// Reason.
    pub why: String,
}

/// Publishes a window as a dead letter. Without `key` (boot and number) the key is taken from its message id, else from its number in the
/// queue.
pub(crate) async fn bury(
    context: &Context,
    message: &Message,
    key: Option<(u32, u32)>,
    by: &str,
    why: &str,
) -> Result<(), String> {
    let info = message.info().map_err(|e| e.to_string())?;
    let hob = message.subject.split('.').nth(2).unwrap_or_default();
    let numbered = || {
        let number = message.headers.as_ref()?.get(NATS_MESSAGE_ID)?;
        parse_window_id(number.as_str(), hob)
    };
    let key = key.or_else(numbered);
    let subject = match key {
        Some((boot, seq)) => names::dead_letter(hob, boot, seq),
        None => names::dead_letter(hob, 0, info.stream_sequence),
    };
    let dead_window = PublishMessage::build()
        .payload(message.payload.clone())
        .header(WHY, header(why))
        .header(BY, header(by))
        .expected_last_subject_sequence(0);
    let sent = context.send_publish(subject, dead_window).await;
    match sent.map_err(|e| e.to_string())?.await {
        Ok(_) => Ok(()),
        // Published by an earlier try.
        Err(e) if e.kind() == PublishErrorKind::WrongLastSequence => Ok(()),
        Err(e) => Err(format!("it cannot be put among the dead: {e}")),
    }
}

/// Makes a header value: no control characters, at most [`MAX_REASON_BYTES`].
fn header(text: &str) -> String {
    let plain = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut text: String = plain.collect();
    while text.len() > MAX_REASON_BYTES {
        text.pop();
    }
    text
}

/// Returns the reason for which a window was given up, with its worker; `None` if it is no dead letter.
pub(crate) async fn why(
    server: &FleetServer,
    hob: &str,
    boot: u32,
    seq: u32,
) -> Result<Option<String>, JetStreamError> {
    let stored = server
        .last(names::DEAD, names::dead_letter(hob, boot, seq))
        .await
        .map_err(|e| JetStreamError::new(names::DEAD, e))?;
    Ok(stored.map(|message| {
        let text = |name: &str| message.headers.get(name).map(ToString::to_string);
        let why = text(WHY).unwrap_or_else(|| "it does not say why".to_owned());
        match text(BY) {
            Some(by) => format!("{why} ({by})"),
            None => why,
        }
    }))
}

/// Filter of dead letters.
#[derive(Clone, Debug, Default)]
pub struct DeadFilter {
    /// Name of the hob; `None` for all.
    pub hob: Option<String>,
    /// Number among the dead letters; `None` for all.
    pub number: Option<u64>,
}

/// Lists dead letters, oldest first.
///
/// # Errors
/// [`JetStreamError`].
pub async fn list(
    context: &Context,
    filter: &DeadFilter,
) -> Result<Vec<DeadWindow>, JetStreamError> {
    let mut windows = Vec::new();
    each(context, filter, |dead_window, _| windows.push(dead_window)).await?;
    Ok(windows)
}

async fn each(
    context: &Context,
    filter: &DeadFilter,
    mut what: impl FnMut(DeadWindow, bytes::Bytes),
) -> Result<(), JetStreamError> {
    let stream = jetstream::stream(context, names::DEAD).await?;
    let subject = names::dead_letter(filter.hob.as_deref().unwrap_or("*"), "*", "*");
    let mut from = filter.number.unwrap_or(1);
    loop {
        let next = stream
            .direct_get_next_for_subject(&*subject, Some(from))
            .await;
        let message = match next {
            Ok(message) => message,
            Err(e) if e.kind() == DirectGetErrorKind::NotFound => return Ok(()),
            Err(e) => return Err(JetStreamError::new(names::DEAD, e)),
        };
        if filter
            .number
            .is_some_and(|number| number != message.sequence)
        {
            return Ok(());
        }
        from = message.sequence + 1;
        let tokens: Vec<&str> = message.subject.split('.').collect();
        let number = |k: usize| tokens.get(k).and_then(|t| t.parse().ok()).unwrap_or(0);
        let text = |name: &str| {
            let value = message.headers.get(name);
            value.map_or(String::new(), ToString::to_string)
        };
        let dead_window = DeadWindow {
            number: message.sequence,
            hob: tokens.get(2).copied().unwrap_or_default().to_owned(),
            boot: number(4),
            seq: number(5),
            at_s: message.time.unix_timestamp(),
            by: text(BY),
            why: text(WHY),
        };
        what(dead_window, message.payload.clone());
    }
}

/// Puts dead letters back into the queue; returns their number. A kill in between leaves one in both; its result is unique all the same, so
/// that it needs no message id, which another key could have used before.
///
/// # Errors
/// [`JetStreamError`]; the letters before the error are replayed.
pub async fn replay(context: &Context, filter: &DeadFilter) -> Result<u64, JetStreamError> {
    let mut windows = Vec::new();
    each(context, filter, |dead_window, payload| {
        windows.push((dead_window, payload))
    })
    .await?;
    let stream = jetstream::stream(context, names::DEAD).await?;
    let mut replayed = 0;
    for (dead_window, payload) in windows {
        let failed = |e: String| JetStreamError::new(names::WINDOWS, e);
        let message = PublishMessage::build().payload(payload);
        let sent = context
            .send_publish(names::window(&dead_window.hob), message)
            .await;
        let sent = sent.map_err(|e| failed(e.to_string()))?.await;
        sent.map_err(|e| failed(e.to_string()))?;
        let deleted = stream.delete_message(dead_window.number).await;
        deleted.map_err(|e| JetStreamError::new(names::DEAD, e))?;
        replayed += 1;
    }
    Ok(replayed)
}

/// Deletes dead letters; returns their number.
///
/// # Errors
/// [`JetStreamError`]; the letters before the error are deleted.
pub async fn delete(context: &Context, filter: &DeadFilter) -> Result<u64, JetStreamError> {
    let stream = jetstream::stream(context, names::DEAD).await?;
    let mut deleted = 0;
    for dead_window in list(context, filter).await? {
        let gone = stream.delete_message(dead_window.number).await;
        gone.map_err(|e| JetStreamError::new(names::DEAD, e))?;
        deleted += 1;
    }
    Ok(deleted)
}
