//! Messages of streams, as published and as stored.

use async_nats::HeaderMap;
use async_nats::jetstream::context::{PublishError, PublishErrorKind};
use bytes::Bytes;
use futures_util::future::BoxFuture;

/// Message to publish.
pub struct Outgoing {
    /// Its subject.
    pub subject: String,
    /// Its bytes.
    pub payload: Bytes,
    /// Message id by which the server detects a duplicate.
    pub number: Option<String>,
    /// Expected number in the stream of the last message of its subject, 0 without one; the server refuses it otherwise.
    pub after: Option<u64>,
}

/// Acknowledgement of a message.
pub struct Acknowledged {
    /// Its number in the stream.
    pub number: u64,
    /// `true` if the stream had it before.
    pub is_duplicate: bool,
}

/// Acknowledgement to come.
pub type PendingAck = BoxFuture<'static, Result<Acknowledged, PublishFailure>>;

/// Reason for which a message is not acknowledged.
#[derive(Debug, thiserror::Error)]
pub enum PublishFailure {
    /// [`Outgoing::after`] does not match.
    #[error("another message of its subject was first")]
    Occupied,
    /// Any other reason.
    #[error("{0}")]
    Other(String),
}

impl From<PublishError> for PublishFailure {
    fn from(why: PublishError) -> Self {
        match why.kind() {
            PublishErrorKind::WrongLastSequence => Self::Occupied,
            _ => Self::Other(why.to_string()),
        }
    }
}

/// Message of a stream.
#[derive(Clone, Debug)]
pub struct StoredMessage {
    /// Its number in the stream.
    pub number: u64,
    /// Its headers.
    pub headers: HeaderMap,
    /// Its bytes.
    pub payload: Bytes,
}
