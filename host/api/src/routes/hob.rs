//! Ratings of the hob.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use ihd_daemon::model::Hob;

use super::App;

/// Returns ratings, limits and the resonance capacitor of all hobs of this build, for the scales of a display.
#[utoipa::path(get, path = "/hob", tag = "daemon", responses((status = 200, body = Hob)))]
pub(super) async fn hob(State(app): State<Arc<App>>) -> Json<Hob> {
    Json(app.backend.hob())
}
