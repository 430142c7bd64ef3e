//! Devices: reports, results, lookups, commands, leases.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use ihd_model::{
    Command, CommandReply, DeviceReport, Lease, LeaseRequest, Problem, StoredLookup, StoredResult,
};
use ihd_store::{LookupRow, ResultFilter, ResultRow};
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use crate::problem::{ApiQuery, ErrorResponse, Holder, JsonBody, PathName};

/// Default number of results in a response.
const DEFAULT_LIMIT: u32 = 100;

/// Maximum number of results in a response.
const MAX_LIMIT: u32 = 10_000;

/// Returns the reports of all devices.
#[utoipa::path(get, path = "/devices", tag = "devices",
    responses((status = 200, body = [DeviceReport])))]
pub(super) async fn all(State(app): State<Arc<App>>) -> Json<Vec<DeviceReport>> {
    Json(app.daemon.view().devices())
}

/// Returns the report of a device.
#[utoipa::path(get, path = "/devices/{name}", tag = "devices",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = DeviceReport), (status = 404, body = Problem)))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
) -> Result<Json<DeviceReport>, ErrorResponse> {
    let device = app.daemon.view().device(&name);
    device
        .map(Json)
        .ok_or_else(|| ErrorResponse::no_device(&name))
}

/// Returns the lookups of a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/lookups", tag = "devices",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = [StoredLookup]), (status = 404, body = Problem)))]
pub(super) async fn lookups(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
) -> Result<Json<Vec<StoredLookup>>, ErrorResponse> {
    let rows = app.daemon.view().lookups(&name).await?;
    Ok(Json(rows.into_iter().rev().map(stored_lookup).collect()))
}

/// Query parameters of the results.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ResultParameters {
    /// Maximum number of results, 1 to 10 000; default 100.
    limit: Option<u32>,
    /// Time of the oldest result, in milliseconds since 1970, UTC.
    since: Option<i64>,
}

/// Returns the results of a device's windows, newest first.
#[utoipa::path(get, path = "/devices/{name}/results", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"), ResultParameters),
    responses((status = 200, body = [StoredResult]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn results(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<ResultParameters>,
) -> Result<Json<Vec<StoredResult>>, ErrorResponse> {
    let limit = parameters.limit.unwrap_or(DEFAULT_LIMIT);
    if !(1..=MAX_LIMIT).contains(&limit) {
        let text = format!("limit is {limit}, but must lie between 1 and {MAX_LIMIT}");
        return Err(ErrorResponse::new(StatusCode::BAD_REQUEST, "query", text));
    }
    if app.daemon.view().device(&name).is_none() {
        return Err(ErrorResponse::no_device(&name));
    }
    let filter = ResultFilter {
        device: Some(name),
        since_ms: parameters.since,
        limit: Some(limit),
    };
    let rows = app.daemon.view().results(filter).await?;
    Ok(Json(rows.into_iter().map(stored_result).collect()))
}

fn stored_result(row: ResultRow) -> StoredResult {
    // JSON has no number for what is not finite.
    let finite = |x: f64| x.is_finite().then_some(x);
    StoredResult {
        device: row.device,
        boot: row.boot,
        seq: row.seq,
        at_ms: row.at_ms,
        half_cycle: row.half_cycle,
        f_sw_hz: row.f_sw_hz,
        i_crest_a: finite(row.i_crest_a),
        power_w: row.power_w.and_then(finite),
        r_ohm: finite(row.r_ohm),
        l_h: finite(row.l_h),
        sigma_r_pct: finite(row.sigma_r_pct),
        sigma_l_pct: finite(row.sigma_l_pct),
        pass: row.pass,
        why: row.why,
        changed_lookup: row.changed_lookup,
    }
}

fn stored_lookup(row: LookupRow) -> StoredLookup {
    StoredLookup {
        version: row.version,
        state: row.state.to_string(),
        origin: row.origin,
        at_ms: row.at_ms,
        why: row.why,
        blob: row.blob,
    }
}

/// Executes a command. All but `off` and recordings require the lease.
#[utoipa::path(post, path = "/devices/{name}/commands", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Name of the client; `off` is done without one")),
    request_body = Command,
    responses((status = 200, body = CommandReply), (status = 404, body = Problem),
        (status = 409, description = "The device refused", body = Problem),
        (status = 423, description = "Another client has the lease", body = Problem),
        (status = 503, description = "The device is not connected", body = Problem)))]
pub(super) async fn command(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    holder: Result<Holder, ErrorResponse>,
    JsonBody(command): JsonBody<Command>,
) -> Result<Json<CommandReply>, ErrorResponse> {
    let holder = match holder {
        // The daemon has a name for nobody.
        Err(_) if command == Command::Off => String::new(),
        named => named?.0,
    };
    Ok(Json(app.daemon.command(&name, &holder, command).await?))
}

/// Acquires or renews the lease; it ends 10 s later.
#[utoipa::path(put, path = "/devices/{name}/lease", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Name of the client")),
    request_body = LeaseRequest,
    responses((status = 200, body = Lease), (status = 404, body = Problem),
        (status = 423, description = "Another client has the lease", body = Problem)))]
pub(super) async fn take_lease(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    Holder(holder): Holder,
    JsonBody(request): JsonBody<LeaseRequest>,
) -> Result<Json<Lease>, ErrorResponse> {
    let lease = app.daemon.take_lease(&name, &holder, request.force).await?;
    Ok(Json(lease))
}

/// Releases the lease; power requested under it ends.
#[utoipa::path(delete, path = "/devices/{name}/lease", tag = "devices",
    params(("name" = String, Path, description = "Name of the device"),
        ("ihd-holder" = String, Header, description = "Name of the client")),
    responses((status = 204), (status = 404, body = Problem), (status = 423, body = Problem)))]
pub(super) async fn release_lease(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    Holder(holder): Holder,
) -> Result<StatusCode, ErrorResponse> {
    app.daemon.release_lease(&name, &holder).await?;
    Ok(StatusCode::NO_CONTENT)
}
