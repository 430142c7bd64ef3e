//! The fleet that the daemon is an edge of.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use ihd_daemon::model::FleetReport;

use super::App;
use super::problem::Failed;
use crate::model::Problem;

/// What a daemon says that is no edge.
const NO_FLEET: &str =
    "this daemon belongs to no fleet: [fleet] url in ihd.toml makes it an edge (docs/fleet.md)";

/// The fleet, as this edge knew it last: devices, edges, workers, and what waits.
#[utoipa::path(get, path = "/fleet", tag = "fleet",
    responses((status = 200, body = FleetReport),
        (status = 404, description = "The daemon is no edge", body = Problem)))]
pub(super) async fn fleet(State(app): State<Arc<App>>) -> Result<Response, Failed> {
    match app.backend.fleet() {
        // Written from where it is: a thousand devices are not copied for each that asks.
        Some(report) => Ok(Json(&*report).into_response()),
        None => Err(Failed::new(StatusCode::NOT_FOUND, "no-fleet", NO_FLEET)),
    }
}
