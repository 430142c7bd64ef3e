//! Many hobs, many workers: windows, results and lookups over NATS JetStream (docs/fleet.md).
//!
//! ```text
//!  Edge (edge/): a daemon ── windows ──► IHD_WINDOWS (work queue) ──► worker.rs ──► IHD_RESULTS ──► the edge again
//!                                                                       └─► IHD_DEAD (dead.rs): given up
//!  names of edges: claims.rs
//!  operator: engine.rs makes all that, status.rs looks at it, captures.rs keeps files
//! ```
//!
//! A window is published under a number of its own and stays in its edge's store until it is acknowledged; a result has a subject of its
//! own, which the server gives out once. So nothing is lost and nothing counts twice, whoever is killed.

mod access;
pub mod captures;
pub mod claims;
pub mod dead;
pub mod discovery;
mod edge;
pub mod engine;
mod identity;
pub mod lookups;
pub mod names;
mod server;
pub mod server_config;
#[cfg(test)]
mod simulation;
pub mod status;
pub mod wire;
pub mod worker;

pub use access::{Access, AccessError};
/// A connection to a server with JetStream.
pub use async_nats::jetstream::Context;
pub use edge::{Edge, EventMessage, StateMessage};
pub use identity::Identity;
