//! The daemon over HTTP, and the client that the command uses.
//!
//! ```text
//!  socket ── limits, TLS ──► Host ──► cross-site ──► token, role ──► route ──► Backend
//!  server.rs  connection.rs   access/hosts.rs   tower-http   access/guard.rs  routes/  backend.rs
//! ```
//!
//! Safe by default: loopback only, and elsewhere nothing without tokens and TLS. `GET` changes nothing. Whoever is slow, greedy
//! or a stranger loses his own connection and nobody else's.

pub mod access;
pub mod backend;
pub mod client;
mod connection;
pub mod daemon_backend;
pub mod model;
mod percent;
mod places;
mod prometheus;
mod routes;
pub mod server;
pub mod tls;
mod traffic;

pub use backend::Backend;
pub use client::ApiClient;
pub use daemon_backend::DaemonBackend;
pub use server::{Server, ServerError, Settings};

/// The API's description in OpenAPI 3.1, as `GET /api/v1/openapi.json` answers it.
pub fn openapi() -> utoipa::openapi::OpenApi {
    routes::described().1
}
