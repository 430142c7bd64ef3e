//! Health for service managers.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use ihd_daemon::Daemon;
use ihd_model::{Health, StoreFailure};
use tokio::sync::Mutex;
use tokio::time::Instant;

use super::App;

/// Lifetime of a cached health: frequent requests must not load the store.
const LIFETIME: Duration = Duration::from_secs(1);

/// Last health; `None` before the first request.
#[derive(Default)]
pub(crate) struct HealthCache(Mutex<Option<(Instant, Health)>>);

impl HealthCache {
    /// Returns the health of the daemon, at most `LIFETIME` old.
    async fn health(&self, daemon: &Daemon) -> Health {
        // Held during the query: concurrent requests wait for the same result.
        let mut cached = self.0.lock().await;
        if let Some((at, health)) = &*cached
            && at.elapsed() < LIFETIME
        {
            return health.clone();
        }
        let responds = daemon.upkeep().store_responds().await;
        let figures = daemon.upkeep().figures();
        let silent = || (!responds).then(|| StoreFailure::silent(daemon.view().now_ms()));
        let store_failure = figures.store_failure.or_else(silent);
        let health = Health {
            service: "ihd".into(),
            store: store_failure.is_none(),
            store_failure,
            audit: figures.audit_is_healthy,
        };
        *cached = Some((Instant::now(), health.clone()));
        health
    }
}

/// Returns the health of the daemon; needs no token. A failure of the store has its cause, its time, the lost records and advice.
#[utoipa::path(get, path = "/healthz", tag = "daemon",
    responses((status = 200, body = Health), (status = 503, body = Health)))]
pub(super) async fn healthz(State(app): State<Arc<App>>) -> (StatusCode, Json<Health>) {
    let health = app.health.health(&app.daemon).await;
    let status = if health.store {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    (status, Json(health))
}
