//! The calls of a NATS server that an edge makes: JetStream's, or those of the simulated server (simulation/).

use std::time::Duration;

use async_nats::HeaderMap;
use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::context::{PublishError, PublishErrorKind};
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::DirectGetErrorKind;
use async_nats::jetstream::{self, AckKind, Context};
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::BoxStream;

use crate::access::{Access, AccessError};
use crate::engine::{self, EngineError};
use crate::names;
#[cfg(test)]
use crate::simulation;

/// A server.
pub enum Server {
    /// JetStream, with the access by which it is reached.
    JetStream(Box<Context>, Access),
    /// One in memory.
    #[cfg(test)]
    Simulated(simulation::Line),
}

/// A message for a stream.
pub struct Outgoing {
    /// Its subject.
    pub subject: String,
    /// Its bytes.
    pub payload: Bytes,
    /// Number by which the server knows it if it comes twice.
    pub number: Option<String>,
    /// Number in the stream of the last message of its subject, 0 without one; else it is refused.
    pub after: Option<u64>,
}

/// Word of the server that it has a message.
pub struct Acknowledged {
    /// Its number in the stream.
    pub number: u64,
    /// It was there before.
    pub is_duplicate: bool,
}

/// Word of the server, in time or not.
pub type UnderWay = BoxFuture<'static, Result<Acknowledged, PublishTrouble>>;

/// Reason for which a message is not acknowledged.
#[derive(Debug, thiserror::Error)]
pub enum PublishTrouble {
    /// [`Outgoing::after`] is not so.
    #[error("another message of its subject was first")]
    Occupied,
    /// Any other.
    #[error("{0}")]
    Other(String),
}

impl From<PublishError> for PublishTrouble {
    fn from(why: PublishError) -> Self {
        match why.kind() {
            PublishErrorKind::WrongLastSequence => Self::Occupied,
            _ => Self::Other(why.to_string()),
        }
    }
}

/// A message of a stream.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Its number there.
    pub number: u64,
    /// Its headers.
    pub headers: HeaderMap,
    /// Its bytes.
    pub payload: Bytes,
}

impl Server {
    /// Looks whether the server is new enough.
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

    /// Sends a message.
    ///
    /// # Errors
    /// The client cannot send it.
    pub async fn publish(&self, message: Outgoing) -> Result<UnderWay, PublishTrouble> {
        match self {
            Self::JetStream(context, _) => publish(context, message).await,
            #[cfg(test)]
            Self::Simulated(line) => line.publish(message).await,
        }
    }

    /// The last message of a subject.
    ///
    /// # Errors
    /// In words.
    pub async fn last(&self, stream: &str, subject: String) -> Result<Option<Kept>, String> {
        match self {
            Self::JetStream(context, _) => last(context, stream, subject).await,
            #[cfg(test)]
            Self::Simulated(line) => line.last(stream, &subject).await,
        }
    }

    /// The consumer of an edge's results: the one that the operator has made; on a server where every key may do all, it is made and kept up
    /// to date.
    ///
    /// # Errors
    /// [`EngineError`].
    pub async fn results(&self, edge: &str, hobs: &[String]) -> Result<Results, EngineError> {
        match self {
            Self::JetStream(context, _) => {
                let consumer = consumer(context, edge, hobs).await?;
                Ok(Results::JetStream(Box::new(consumer)))
            }
            #[cfg(test)]
            Self::Simulated(line) => line.results().await.map(Results::Simulated),
        }
    }
}

async fn publish(context: &Context, message: Outgoing) -> Result<UnderWay, PublishTrouble> {
    let mut built = PublishMessage::build().payload(message.payload);
    if let Some(number) = message.number {
        built = built.message_id(number);
    }
    if let Some(after) = message.after {
        built = built.expected_last_subject_sequence(after);
    }
    // The client waits for each acknowledgement as long as for any.
    let acknowledged = context.send_publish(message.subject, built).await?;
    Ok(Box::pin(async move {
        let acknowledged = acknowledged.await?;
        Ok(Acknowledged {
            number: acknowledged.sequence,
            is_duplicate: acknowledged.duplicate,
        })
    }))
}

/// The last message of a subject, on a server with JetStream.
///
/// # Errors
/// In words.
pub async fn last(
    context: &Context,
    stream: &str,
    subject: String,
) -> Result<Option<Kept>, String> {
    let stream = context.get_stream_no_info(stream).await;
    let stream = stream.map_err(|e| e.to_string())?;
    match stream.direct_get_last_for_subject(subject).await {
        Ok(message) => Ok(Some(Kept {
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
) -> Result<Consumer<pull::Config>, EngineError> {
    let config = engine::edge_consumer(edge, hobs);
    let made = context.create_consumer_on_stream(config, names::RESULTS);
    if let Ok(consumer) = made.await {
        return Ok(consumer);
    }
    let name = names::edge_consumer(edge);
    let found = context.get_consumer_from_stream(&name, names::RESULTS);
    found.await.map_err(|e| {
        let hobs = hobs.join(",");
        let why = format!("{e}: the operator makes it, `ihd fleet init --edge {edge}={hobs}`");
        EngineError::new(&name, why)
    })
}

/// The consumer of an edge's results.
pub enum Results {
    /// JetStream's.
    JetStream(Box<Consumer<pull::Config>>),
    /// One in memory.
    #[cfg(test)]
    Simulated(simulation::Results),
}

impl Results {
    /// When it was made, in microseconds since 1970, by the server's clock: another time is another consumer.
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

    /// Asks for results, and waits for the first so long. An error in their stream ends the consumer or the connection.
    ///
    /// # Errors
    /// In words.
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
            Self::Simulated(results) => results.fetch(most, wait).await,
        }
    }
}

/// A result that came.
pub enum Incoming {
    /// JetStream's.
    JetStream(Box<jetstream::Message>),
    /// One in memory.
    #[cfg(test)]
    Simulated(simulation::Delivered),
}

impl Incoming {
    /// Its subject.
    pub fn subject(&self) -> &str {
        match self {
            Self::JetStream(message) => &message.subject,
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.subject(),
        }
    }

    /// Its bytes.
    pub fn payload(&self) -> &Bytes {
        match self {
            Self::JetStream(message) => &message.payload,
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.payload(),
        }
    }

    /// It is taken in. Where this is lost, it comes again.
    pub async fn ack(&self) {
        self.settle(AckKind::Ack).await;
    }

    /// It is to come again after so long.
    pub async fn again(&self, after: Duration) {
        self.settle(AckKind::Nak(Some(after))).await;
    }

    /// It is not to come again.
    pub async fn end(&self) {
        self.settle(AckKind::Term).await;
    }

    async fn settle(&self, kind: AckKind) {
        match self {
            Self::JetStream(message) => {
                let _ = message.ack_with(kind).await;
            }
            #[cfg(test)]
            Self::Simulated(delivered) => delivered.settle(kind).await,
        }
    }
}
