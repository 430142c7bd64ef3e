//! Devices: what they are, and what is asked of them.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use ihd_daemon::model::{Command, DeviceReport, Done, Lease};
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use super::problem::{Asked, Body, Failed, Holder};
use crate::model::{LeaseRequest, Problem, StoredLookup, StoredResult};

/// Results in an answer, unless told otherwise.
const DEFAULT_LIMIT: u32 = 100;

/// Most results in an answer.
const MAX_LIMIT: u32 = 10_000;

/// Every device.
#[utoipa::path(get, path = "/devices", tag = "devices",
    responses((status = 200, body = [DeviceReport])))]
pub(super) async fn all(State(app): State<Arc<App>>) -> Json<Vec<DeviceReport>> {
    Json(app.backend.devices())
}

/// One device.
#[utoipa::path(get, path = "/devices/{name}", tag = "devices",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = DeviceReport), (status = 404, body = Problem)))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
) -> Result<Json<DeviceReport>, Failed> {
    let device = app.backend.device(&name);
    device.map(Json).ok_or_else(|| Failed::no_device(&name))
}

/// Lookups of a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/lookups", tag = "devices",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = [StoredLookup]), (status = 404, body = Problem)))]
pub(super) async fn lookups(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
) -> Result<Json<Vec<StoredLookup>>, Failed> {
    Ok(Json(app.backend.lookups(&name).await?))
}

/// Which results.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichResults {
    /// At most so many, 1 to 10 000; 100 unless told.
    limit: Option<u32>,
    /// None before this, in milliseconds since 1970, UTC.
    since: Option<i64>,
}

/// What a device's windows taught, newest first.
#[utoipa::path(get, path = "/devices/{name}/results", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"), WhichResults),
    responses((status = 200, body = [StoredResult]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn results(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(which): Asked<WhichResults>,
) -> Result<Json<Vec<StoredResult>>, Failed> {
    let limit = which.limit.unwrap_or(DEFAULT_LIMIT);
    if !(1..=MAX_LIMIT).contains(&limit) {
        let text = format!("limit is {limit}, but must lie between 1 and {MAX_LIMIT}");
        return Err(Failed::new(StatusCode::BAD_REQUEST, "query", text));
    }
    let results = app.backend.results(&name, limit, which.since).await?;
    Ok(Json(results))
}

/// Carries out a command. All but `off` and recordings need the lease.
#[utoipa::path(post, path = "/devices/{name}/commands", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Who asks")),
    request_body = Command,
    responses((status = 200, body = Done), (status = 404, body = Problem),
        (status = 409, description = "The device said no", body = Problem),
        (status = 423, description = "Somebody else has the lease", body = Problem),
        (status = 503, description = "The device is not there", body = Problem)))]
pub(super) async fn command(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Holder(holder): Holder,
    Body(command): Body<Command>,
) -> Result<Json<Done>, Failed> {
    Ok(Json(app.backend.command(&name, &holder, command).await?))
}

/// Takes the lease, or renews it; it ends 10 s later.
#[utoipa::path(put, path = "/devices/{name}/lease", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Who asks")),
    request_body = LeaseRequest,
    responses((status = 200, body = Lease), (status = 404, body = Problem),
        (status = 423, description = "Somebody else has it", body = Problem)))]
pub(super) async fn take_lease(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Holder(holder): Holder,
    Body(wanted): Body<LeaseRequest>,
) -> Result<Json<Lease>, Failed> {
    let lease = app.backend.take_lease(&name, &holder, wanted.force).await?;
    Ok(Json(lease))
}

/// Gives the lease back; power that was asked for under it ends.
#[utoipa::path(delete, path = "/devices/{name}/lease", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Who asks")),
    responses((status = 204), (status = 404, body = Problem), (status = 423, body = Problem)))]
pub(super) async fn release_lease(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Holder(holder): Holder,
) -> Result<StatusCode, Failed> {
    app.backend.release_lease(&name, &holder).await?;
    Ok(StatusCode::NO_CONTENT)
}
