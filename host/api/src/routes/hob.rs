//! Ratings of the hob.

use axum::Json;
use ihd_model::Hob;

/// Returns ratings, limits and the resonance capacitor of all hobs of this build, for the scales of a display.
#[utoipa::path(get, path = "/hob", tag = "daemon", responses((status = 200, body = Hob)))]
pub(super) async fn hob() -> Json<Hob> {
    Json(ihd_daemon::hob())
}
