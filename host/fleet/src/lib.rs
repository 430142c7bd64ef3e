//! Many hobs, many workers: windows, results and lookups over NATS JetStream (docs/fleet.md).
//!
//! ```text
//!  Edge (edge/): a daemon ── windows ──► IHD_WINDOWS (work queue) ──► worker.rs ──► IHD_RESULTS ──► the edge again
//!                                                                       └─► IHD_DEAD (dead_letters.rs): given up
//!  names of edges: claims.rs
//!  operator: jetstream/ makes streams and buckets, status.rs reports, captures.rs stores files
//! ```
//!
//! A window is published under a number of its own and stays in its edge's store until it is acknowledged. A result has a subject of its
//! own, on which the server accepts one message. So no window is lost or counted twice if any process is killed.

mod access;
pub mod captures;
pub mod claims;
mod clock;
pub mod dead_letters;
pub mod discovery;
mod edge;
pub mod jetstream;
pub mod lookups;
mod message_ids;
pub mod names;
mod server;
pub mod server_config;
#[cfg(test)]
mod simulation;
mod standing;
pub mod status;
mod stream_message;
pub mod wire;
pub mod worker;

pub use access::{Access, AccessError};
/// A connection to a server with JetStream.
pub use async_nats::jetstream::Context;
pub use edge::{Edge, EventMessage, StateMessage};
pub use message_ids::MessageIds;
