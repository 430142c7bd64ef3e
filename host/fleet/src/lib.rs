//! Many hobs, many workers: windows, results and lookups over NATS JetStream.

pub mod discovery;
pub mod names;
pub mod server_config;
