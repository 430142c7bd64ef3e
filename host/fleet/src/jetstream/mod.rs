//! Streams, consumers and buckets on the server, made by `ihd-fleet init`, with their limits (docs/fleet.md).

mod buckets;
mod error;
mod init;
mod limits;

use async_nats::jetstream::{Context, stream};

pub use buckets::{BucketEntry, bucket, entries};
pub(crate) use buckets::{put, remove};
pub use error::JetStreamError;
pub(crate) use error::missing;
pub use init::{init, init_edge, limits};
pub use limits::{
    ACK_WAIT, DUPLICATES_WITHIN, FleetLimits, MAX_DELIVERIES, MAX_PASSED_ON, PER_THREAD,
    SILENT_AFTER, edge_consumer,
};

/// Opens a stream of the fleet.
///
/// # Errors
/// [`JetStreamError`] if the server refuses or does not answer; a missing object is made by `ihd-fleet init`.
pub async fn stream(context: &Context, name: &str) -> Result<stream::Stream, JetStreamError> {
    let stream = context.get_stream(name).await;
    stream.map_err(|e| missing(name, e))
}
