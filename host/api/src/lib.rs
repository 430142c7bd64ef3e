//! HTTP API of the daemon, and its client.
//!
//! ```text
//!  socket ── limits, TLS ──► Host ──► cross-site ──► token, role ──► route ──► Daemon
//!  server.rs  connection.rs   access/hosts.rs   tower-http   access/guard.rs  routes/
//! ```
//!
//! Safe by default: the server listens on loopback only; any other address requires tokens and TLS. `GET` changes nothing. A client that is
//! slow, sends too much or has no token can lose its own connection only.

pub mod access;
pub mod client;
mod connection;
mod percent;
mod problem;
mod prometheus;
mod routes;
mod served;
pub mod server;
mod slots;
mod stamp;
pub mod tls;
mod traffic;

pub use client::ApiClient;
pub use server::{ApiServer, ApiServerError, ServerOptions};

/// Returns the OpenAPI 3.1 description of the API, as `GET /api/v1/openapi.json` does.
pub fn openapi() -> utoipa::openapi::OpenApi {
    routes::described().1
}
