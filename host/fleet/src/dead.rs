//! Windows that were given up: where they go, and the way back.

use async_nats::header::NATS_MESSAGE_ID;
use async_nats::jetstream::context::PublishErrorKind;
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::DirectGetErrorKind;
use async_nats::jetstream::{Context, Message};
use serde::Serialize;

use crate::engine::{self, EngineError};
use crate::identity::window_of;
use crate::names;
use crate::server::Server;

/// Headers of a window that was given up.
pub(crate) const WHY: &str = "Ihd-Why";
pub(crate) const BY: &str = "Ihd-By";

/// Longest reason, in bytes: headers are short.
const LONGEST_WHY: usize = 500;

/// A window that was given up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeadWindow {
    /// Its number among the dead.
    pub number: u64,
    /// The hob's name.
    pub hob: String,
    /// The hob's boot, 0 where it could not be read.
    pub boot: u64,
    /// The window's number; where the boot could not be read, that of the message in the queue.
    pub seq: u64,
    /// When, in seconds since 1970, UTC.
    pub at_s: i64,
    /// The worker.
    pub by: String,
    /// Why.
    pub why: String,
}

/// Puts a window among the dead. Where `key` (boot and number) could not be read, it is what the edge has numbered it by; where it has not, its
/// number in the queue.
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
        window_of(number.as_str(), hob)
    };
    let key = key.or_else(numbered);
    let subject = match key {
        Some((boot, seq)) => names::dead(hob, boot, seq),
        None => names::dead(hob, 0, info.stream_sequence),
    };
    let dead = PublishMessage::build()
        .payload(message.payload.clone())
        .header(WHY, header(why))
        .header(BY, header(by))
        .expected_last_subject_sequence(0);
    let sent = context.send_publish(subject, dead).await;
    match sent.map_err(|e| e.to_string())?.await {
        Ok(_) => Ok(()),
        // It is there from a try before.
        Err(e) if e.kind() == PublishErrorKind::WrongLastSequence => Ok(()),
        Err(e) => Err(format!("it cannot be put among the dead: {e}")),
    }
}

/// Headers have no line ends and no control characters.
fn header(text: &str) -> String {
    let plain = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut text: String = plain.collect();
    while text.len() > LONGEST_WHY {
        text.pop();
    }
    text
}

/// Reason for which a window was given up, and its worker; none where it is not among the dead.
pub(crate) async fn why(
    server: &Server,
    hob: &str,
    boot: u32,
    seq: u32,
) -> Result<Option<String>, EngineError> {
    let found = server
        .last(names::DEAD, names::dead(hob, boot, seq))
        .await
        .map_err(|e| EngineError::new(names::DEAD, e))?;
    Ok(found.map(|message| {
        let text = |name: &str| message.headers.get(name).map(ToString::to_string);
        let why = text(WHY).unwrap_or_else(|| "it does not say why".to_owned());
        match text(BY) {
            Some(by) => format!("{why} ({by})"),
            None => why,
        }
    }))
}

/// Which of the dead.
#[derive(Clone, Debug, Default)]
pub struct DeadFilter {
    /// Those of this hob alone.
    pub hob: Option<String>,
    /// That of this number among the dead alone.
    pub number: Option<u64>,
}

/// The dead, oldest first.
///
/// # Errors
/// [`EngineError`].
pub async fn list(context: &Context, filter: &DeadFilter) -> Result<Vec<DeadWindow>, EngineError> {
    let mut found = Vec::new();
    each(context, filter, |dead, _| found.push(dead)).await?;
    Ok(found)
}

async fn each(
    context: &Context,
    filter: &DeadFilter,
    mut what: impl FnMut(DeadWindow, bytes::Bytes),
) -> Result<(), EngineError> {
    let stream = engine::stream(context, names::DEAD).await?;
    let subject = names::dead(filter.hob.as_deref().unwrap_or("*"), "*", "*");
    let mut from = filter.number.unwrap_or(1);
    loop {
        let next = stream
            .direct_get_next_for_subject(&*subject, Some(from))
            .await;
        let message = match next {
            Ok(message) => message,
            Err(e) if e.kind() == DirectGetErrorKind::NotFound => return Ok(()),
            Err(e) => return Err(EngineError::new(names::DEAD, e)),
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
        let dead = DeadWindow {
            number: message.sequence,
            hob: tokens.get(2).copied().unwrap_or_default().to_owned(),
            boot: number(4),
            seq: number(5),
            at_s: message.time.unix_timestamp(),
            by: text(BY),
            why: text(WHY),
        };
        what(dead, message.payload.clone());
    }
}

/// Puts dead windows back into the queue; how many. Killed between, one is in both: its result is unique all the same.
///
/// # Errors
/// [`EngineError`]; those before are replayed.
pub async fn replay(context: &Context, filter: &DeadFilter) -> Result<u64, EngineError> {
    let mut found = Vec::new();
    each(context, filter, |dead, payload| found.push((dead, payload))).await?;
    let stream = engine::stream(context, names::DEAD).await?;
    let mut replayed = 0;
    for (dead, payload) in found {
        let failed = |e: String| EngineError::new(names::WINDOWS, e);
        let message = PublishMessage::build()
            .payload(payload)
            .message_id(format!("replay-{}-{}", dead.number, dead.at_s));
        let sent = context
            .send_publish(names::window(&dead.hob), message)
            .await;
        let sent = sent.map_err(|e| failed(e.to_string()))?.await;
        sent.map_err(|e| failed(e.to_string()))?;
        let deleted = stream.delete_message(dead.number).await;
        deleted.map_err(|e| EngineError::new(names::DEAD, e))?;
        replayed += 1;
    }
    Ok(replayed)
}

/// Deletes dead windows; how many.
///
/// # Errors
/// [`EngineError`]; those before are deleted.
pub async fn delete(context: &Context, filter: &DeadFilter) -> Result<u64, EngineError> {
    let stream = engine::stream(context, names::DEAD).await?;
    let mut deleted = 0;
    for dead in list(context, filter).await? {
        let gone = stream.delete_message(dead.number).await;
        gone.map_err(|e| EngineError::new(names::DEAD, e))?;
        deleted += 1;
    }
    Ok(deleted)
}
