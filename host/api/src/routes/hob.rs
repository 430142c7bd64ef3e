//! What every hob of this build has.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use ihd_daemon::model::Hob;

use super::App;

/// Ratings, limits and the resonance capacitor: what a display draws in.
#[utoipa::path(get, path = "/hob", tag = "daemon", responses((status = 200, body = Hob)))]
pub(super) async fn hob(State(app): State<Arc<App>>) -> Json<Hob> {
    Json(app.backend.hob())
}
