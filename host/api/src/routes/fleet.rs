//! Fleet of which the daemon is an edge.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use ihd_model::{FleetReport, Problem};

use super::App;
use crate::problem::ErrorResponse;

/// Error message of a daemon that is not an edge.
const NO_FLEET: &str =
    "this daemon belongs to no fleet: [fleet] url in ihd.toml makes it an edge (docs/fleet.md)";

/// Returns the last report of the fleet: devices, edges, workers, queues.
#[utoipa::path(get, path = "/fleet", tag = "fleet",
    responses((status = 200, body = FleetReport),
        (status = 404, description = "The daemon is not an edge", body = Problem)))]
pub(super) async fn fleet(State(app): State<Arc<App>>) -> Result<Response, ErrorResponse> {
    match app.daemon.fleet().report() {
        // Serialised in place: a report of a thousand devices is not copied for each request.
        Some(report) => Ok(Json(&*report).into_response()),
        None => Err(ErrorResponse::new(
            StatusCode::NOT_FOUND,
            "no-fleet",
            NO_FLEET,
        )),
    }
}
