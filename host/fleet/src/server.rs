//! Calls of the server that an edge makes: JetStream, or the simulated server (simulation/).

use std::time::Duration;

use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::DirectGetErrorKind;
use async_nats::jetstream::{AckKind, Context, Message};
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::BoxStream;

use crate::access::{Access, AccessError};
use crate::jetstream::{self, JetStreamError};
use crate::names;
#[cfg(test)]
use crate::simulation::line;
use crate::stream_message::{Acknowledged, Outgoing, PendingAck, PublishFailure, StoredMessage};

/// A server.
pub enum FleetServer {
    /// JetStream, with the access by which it is reached.
    JetStream(Box<Context>, Access),
    /// One in memory.
    #[cfg(test)]
    Simulated(line::SimulatedConnection),
}

impl FleetServer {
    /// Checks that the server is new enough.
    ///
    /// # Errors
    /// [`AccessError::Old`].
    pub fn check(&self) -> Result<(), AccessError> {
        match self {
            Self::JetStream(context, access) => access.check(&context.client()),
            #[cfg(test)]
            Self::Simulated(_) => Ok(()),
        }
    }

    /// Publishes a message; the acknowledgement is awaited apart.
    ///
    /// # Errors
    /// [`PublishFailure`] if the client cannot send it.
    pub async fn publish(&self, message: Outgoing) -> Result<PendingAck, PublishFailure> {
        match self {
            Self::JetStream(context, _) => publish(context, message).await,
            #[cfg(test)]
            Self::Simulated(line) => line.publish(message).await,
        }
    }

    /// Returns the last message of a subject.
    ///
    /// # Errors
    /// Text of the client's error.
    pub async fn last(
        &self,
        stream: &str,
        subject: String,
    ) -> Result<Option<StoredMessage>, String> {
        match self {
            Self::JetStream(context, _) => last(context, stream, subject).await,
            #[cfg(test)]
            Self::Simulated(line) => line.last(stream, &subject).await,
        }
    }

    /// Returns the consumer of an edge's results: the operator's, or on a server without keys one that is made and kept up to date here.
    ///
    /// # Errors
    /// [`JetStreamError`].
    pub async fn results(
        &self,
        edge: &str,
        hobs: &[String],
    ) -> Result<ResultConsumer, JetStreamError> {
        match self {
            Self::JetStream(context, _) => {
                let consumer = consumer(context, edge, hobs).await?;
                Ok(ResultConsumer::JetStream(Box::new(consumer)))
            }
            #[cfg(test)]
            Self::Simulated(line) => line.results().await.map(ResultConsumer::Simulated),
        }
    }
}

async fn publish(context: &Context, message: Outgoing) -> Result<PendingAck, PublishFailure> {
    let mut built = PublishMessage::build().payload(message.payload);
    if let Some(number) = message.number {
        built = built.message_id(number);
    }
    if let Some(after) = message.after {
        built = built.expected_last_subject_sequence(after);
    }
    // The client applies its own time-out to each acknowledgement.
    let acknowledged = context.send_publish(message.subject, built).await?;
    Ok(Box::pin(async move {
        let acknowledged = acknowledged.await?;
        Ok(Acknowledged {
            number: acknowledged.sequence,
            is_duplicate: acknowledged.duplicate,
        })
    }))
}

/// Returns the last message of a subject, on a server with JetStream.
///
/// # Errors
/// Text of the client's error.
pub async fn last(
    context: &Context,
    stream: &str,
    subject: String,
) -> Result<Option<StoredMessage>, String> {
    let stream = context.get_stream_no_info(stream).await;
    let stream = stream.map_err(|e| e.to_string())?;
    match stream.direct_get_last_for_subject(subject).await {
        Ok(message) => Ok(Some(StoredMessage {
            number: message.sequence,
            headers: message.headers,
            payload: message.payload,
        })),
        Err(e) if e.kind() == DirectGetErrorKind::NotFound => Ok(None),
        Err(e) => Err(e.to_string()),
    }
}

async fn consumer(
    context: &Context,
    edge: &str,
    hobs: &[String],
) -> Result<Consumer<pull::Config>, JetStreamError> {
    let config = jetstream::edge_consumer(edge, hobs);
    let made = context.create_consumer_on_stream(config, names::RESULTS);
    if let Ok(consumer) = made.await {
        return Ok(consumer);
    }
    let name = names::edge_consumer(edge);
    let consumer = context.get_consumer_from_stream(&name, names::RESULTS);
    consumer.await.map_err(|e| {
        let hobs = hobs.join(",");
        let why = format!("{e}: the operator makes it, `ihd-fleet init --edge {edge}={hobs}`");
        JetStreamError::new(&name, why)
    })
}

/// Returns the hobs whose results a consumer with these filters does not receive; one without filters receives all.
fn missing<'a>(filters: &[&str], hobs: &'a [String]) -> Vec<&'a str> {
    let is_there = |hob: &str| {
        let of_hob = [names::results(hob), names::results("*")];
        filters.is_empty() || filters.iter().any(|f| of_hob.iter().any(|own| own == f))
    };
    let hobs = hobs.iter().map(String::as_str);
    hobs.filter(|hob| !is_there(hob)).collect()
}

/// Consumer of an edge's results.
pub enum ResultConsumer {
    /// JetStream's.
    JetStream(Box<Consumer<pull::Config>>),
    /// One in memory.
    #[cfg(test)]
    Simulated(line::SimulatedConsumer),
}

impl ResultConsumer {
    /// Returns the time of its creation in microseconds since 1970, by the server's clock; it identifies the consumer.
    pub fn made_us(&self) -> i64 {
        match self {
            Self::JetStream(consumer) => {
                let made_ns = consumer.cached_info().created.unix_timestamp_nanos();
                i64::try_from(made_ns / 1_000).unwrap_or(0)
            }
            #[cfg(test)]
            Self::Simulated(results) => results.made_us(),
        }
    }

    /// Returns the hobs whose results do not arrive, because the operator made the consumer without them.
    pub fn missing<'a>(&self, hobs: &'a [String]) -> Vec<&'a str> {
        match self {
            Self::JetStream(consumer) => {
                let config = &consumer.cached_info().config;
                let filters = config
                    .filter_subjects
                    .iter()
                    .chain([&config.filter_subject]);
                let filters: Vec<&str> = filters.map(String::as_str).collect();
                let filters: Vec<&str> = filters.into_iter().filter(|f| !f.is_empty()).collect();
                missing(&filters, hobs)
            }
            #[cfg(test)]
            Self::Simulated(_) => missing(&[], hobs),
        }
    }

    /// Requests up to `most` results, waiting for the first up to `wait`. An error in the stream means that the consumer or the connection has ended.
    ///
    /// # Errors
    /// Text of the client's error.
    pub async fn fetch(
        &self,
        most: usize,
        wait: Duration,
    ) -> Result<BoxStream<'static, Result<Incoming, String>>, String> {
        match self {
            Self::JetStream(consumer) => {
                let fetched = consumer.fetch().max_messages(most).expires(wait);
                let fetched = fetched.messages().await.map_err(|e| e.to_string())?;
                let incoming = fetched.map(|message| match message {
                    Ok(message) => Ok(Incoming::JetStream(Box::new(message))),
                    Err(why) => Err(why.to_string()),
                });
                Ok(incoming.boxed())
            }
            #[cfg(test)]
            Self::Simulated(results) => {
                let delivered = results.fetch(most, wait).await?;
                let incoming = delivered.map(|message| message.map(Incoming::Simulated));
                Ok(incoming.boxed())
            }
        }
    }
}

/// Result received from the server.
pub enum Incoming {
    /// JetStream's.
    JetStream(Box<Message>),
    /// One in memory.
    #[cfg(test)]
    Simulated(line::Delivered),
}

impl Incoming {
    /// Returns its subject.
    pub fn subject(&self) -> &str {
        match self {
            Self::JetStream(message) => &message.subject,
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.subject(),
        }
    }

    /// Returns its bytes.
    pub fn payload(&self) -> &Bytes {
        match self {
            Self::JetStream(message) => &message.payload,
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.payload(),
        }
    }

    /// Acknowledges it. If this is lost, it comes again.
    pub async fn ack(&self) {
        self.acknowledge_as(AckKind::Ack).await;
    }

    /// Requests a redelivery after a time.
    pub async fn redeliver(&self, after: Duration) {
        self.acknowledge_as(AckKind::Nak(Some(after))).await;
    }

    /// Refuses it for good.
    pub async fn terminate(&self) {
        self.acknowledge_as(AckKind::Term).await;
    }

    async fn acknowledge_as(&self, kind: AckKind) {
        match self {
            Self::JetStream(message) => {
                let _ = message.ack_with(kind).await;
            }
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.acknowledge_as(kind).await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hob_that_the_consumer_does_not_have_is_missing() {
        let hobs = ["aaa", "test"].map(str::to_owned);
        let test = names::results("test");
        assert_eq!(missing(&[&test], &hobs), ["aaa"]);
        assert_eq!(missing(&[&test, &names::results("aaa")], &hobs), [""; 0]);
        for all in [&[][..], &[&*names::results("*")]] {
            assert_eq!(missing(all, &hobs), [""; 0]);
        }
    }
}
