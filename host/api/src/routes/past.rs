//! Stored data for a display: history, windows, fits and maps of a device, and the journal.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use ihd_daemon::{JournalFilter, MAX_COLUMNS};
use ihd_model::{
    Fit, History, JournalEntry, Map, PotCurve, Problem, Scope, WindowQuery, WindowSummary,
};
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use crate::problem::{ApiQuery, ErrorResponse, PathName};

/// Default number of columns of a history.
const HISTORY_COLUMNS: u32 = 600;

/// Default number of columns of a window.
const WINDOW_COLUMNS: u32 = 1_200;

/// Default span of a history, in milliseconds.
const HISTORY_MS: i64 = 300_000;

/// Maximum number of rows in a response.
const MAX_ROWS: usize = 10_000;

/// Returns `value`, or `default` if it is `None`.
///
/// # Errors
/// 400 if it is not in 1 to `max`.
fn checked_count(
    name: &str,
    value: Option<u32>,
    default: u32,
    max: usize,
) -> Result<usize, ErrorResponse> {
    match value.unwrap_or(default) {
        n if (1..=max).contains(&(n as usize)) => Ok(n as usize),
        n => Err(bad_query(format!(
            "{name} is {n}, but must lie between 1 and {max}"
        ))),
    }
}

fn bad_query(text: String) -> ErrorResponse {
    ErrorResponse::new(StatusCode::BAD_REQUEST, "query", text)
}

/// Query parameters of a history.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HistoryParameters {
    /// Start, in milliseconds since 1970, UTC; default: 5 minutes before the end.
    from: Option<i64>,
    /// End, in milliseconds since 1970, UTC; default: now.
    to: Option<i64>,
    /// Maximum number of columns, 1 to 4000; default 600.
    columns: Option<u32>,
}

/// Returns telemetry of a device over minutes to months, in columns of a display.
#[utoipa::path(get, path = "/devices/{name}/history", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), HistoryParameters),
    responses((status = 200, body = History), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn history(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<HistoryParameters>,
) -> Result<Json<History>, ErrorResponse> {
    let columns = checked_count("columns", parameters.columns, HISTORY_COLUMNS, MAX_COLUMNS)?;
    let to_ms = parameters.to.unwrap_or_else(|| app.daemon.view().now_ms());
    let from_ms = parameters.from.unwrap_or(to_ms.saturating_sub(HISTORY_MS));
    if from_ms >= to_ms {
        return Err(bad_query(format!(
            "from is {from_ms} and to is {to_ms}: from must lie before to"
        )));
    }
    let history = app.daemon.view().history(&name, from_ms, to_ms, columns);
    Ok(Json(history.await?))
}

/// Returns the rise of the pot temperature since the pot was placed, over the last hour, with its standard deviation. It is not an
/// absolute temperature, and protection does not use it.
#[utoipa::path(get, path = "/devices/{name}/pot-temperature", tag = "past",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = PotCurve), (status = 404, body = Problem)))]
pub(super) async fn pot_temperature(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
) -> Result<Json<PotCurve>, ErrorResponse> {
    let curve = app.daemon.view().pot_curve(&name);
    Ok(Json(curve.ok_or_else(|| ErrorResponse::no_device(&name))?))
}

/// Query parameters of lists.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LimitParameters {
    /// Maximum number of entries, 1 to 10 000; default 100 for windows, 50 for fits.
    limit: Option<u32>,
}

/// Returns the stored windows of a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/windows", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), LimitParameters),
    responses((status = 200, body = [WindowSummary]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn windows(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<LimitParameters>,
) -> Result<Json<Vec<WindowSummary>>, ErrorResponse> {
    let limit = checked_count("limit", parameters.limit, 100, MAX_ROWS)?;
    Ok(Json(app.daemon.view().windows(&name, limit).await?))
}

/// Query parameters of a window.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WindowParameters {
    /// Boot of the device, together with `seq`; default: the newest window with samples.
    boot: Option<u32>,
    /// Number of the window since that boot.
    seq: Option<u32>,
    /// Start of the view, in seconds after the window's first pair; default 0.
    from_s: Option<f64>,
    /// End of the view, in seconds after the first pair; default: end of the window.
    to_s: Option<f64>,
    /// Maximum number of columns, 1 to 4000; default 1200.
    columns: Option<u32>,
}

impl WindowParameters {
    fn query(&self) -> Result<WindowQuery, ErrorResponse> {
        let columns = checked_count("columns", self.columns, WINDOW_COLUMNS, MAX_COLUMNS)?;
        let which = match (self.boot, self.seq) {
            (Some(boot), Some(seq)) => Some((boot, seq)),
            (None, None) => None,
            _ => return Err(bad_query("boot and seq go together".into())),
        };
        let (from_s, to_s) = (
            self.from_s.unwrap_or(0.0),
            self.to_s.unwrap_or(f64::INFINITY),
        );
        // Rejects NaN, for which both comparisons are false.
        if !(from_s.is_finite() && from_s < to_s) {
            return Err(bad_query(format!(
                "from_s is {from_s} and to_s is {to_s}: from_s must lie before to_s"
            )));
        }
        Ok(WindowQuery {
            which,
            from_s,
            to_s,
            columns,
        })
    }
}

/// Returns voltage and current of a window for a scope view, and R and L over it.
#[utoipa::path(get, path = "/devices/{name}/window", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), WindowParameters),
    responses((status = 200, body = Scope), (status = 400, body = Problem),
        (status = 404, description = "No such device, or no such window with samples", body = Problem)))]
pub(super) async fn window(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<WindowParameters>,
) -> Result<Json<Scope>, ErrorResponse> {
    let scope = app.daemon.view().scope(&name, parameters.query()?).await?;
    scope.map(Json).ok_or_else(|| {
        let text = "the store has no such window with its samples: the device has not heated yet, or `keep` dropped it";
        ErrorResponse::new(StatusCode::NOT_FOUND, "no-window", text)
    })
}

/// Returns the fits of the network for a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/training", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), LimitParameters),
    responses((status = 200, body = [Fit]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn training(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<LimitParameters>,
) -> Result<Json<Vec<Fit>>, ErrorResponse> {
    let limit = checked_count("limit", parameters.limit, 50, MAX_ROWS)?;
    Ok(Json(app.daemon.view().training(&name, limit).await?))
}

/// Query parameters of a map.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MapParameters {
    /// Version of the lookup; 0 is the built-in one. Default: the lookup of the device.
    version: Option<u32>,
}

/// Returns a lookup in ohm and henry, with the origin of each cell.
#[utoipa::path(get, path = "/devices/{name}/map", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), MapParameters),
    responses((status = 200, body = Map), (status = 400, body = Problem),
        (status = 404, description = "No such device or version", body = Problem)))]
pub(super) async fn map(
    State(app): State<Arc<App>>,
    PathName(name): PathName,
    ApiQuery(parameters): ApiQuery<MapParameters>,
) -> Result<Json<Map>, ErrorResponse> {
    let map = app.daemon.view().map(&name, parameters.version).await?;
    map.map(Json).ok_or_else(|| {
        let text = match parameters.version {
            Some(version) => format!("the store has no lookup of version {version} of {name}; its lookups list those that there are"),
            None => format!("it is not known which lookup {name} uses; version=0 is the built-in one"),
        };
        ErrorResponse::new(StatusCode::NOT_FOUND, "no-version", text)
    })
}

/// Query parameters of the journal.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct JournalParameters {
    /// Entries of this device; default: of all.
    device: Option<String>,
    /// Entries of this kind: `fault`, `pot`, `state`, `command`, …; default: all.
    kind: Option<String>,
    /// Time of the oldest entry, in milliseconds since 1970, UTC.
    since: Option<i64>,
    /// Only entries before this time, in milliseconds since 1970, UTC; the `at_ms` of the last entry gives the next page.
    before: Option<i64>,
    /// Maximum number of entries, 1 to 10 000; default 200.
    limit: Option<u32>,
}

/// Returns events and commands, newest first.
#[utoipa::path(get, path = "/journal", tag = "past", params(JournalParameters),
    responses((status = 200, body = [JournalEntry]), (status = 400, body = Problem)))]
pub(super) async fn journal(
    State(app): State<Arc<App>>,
    ApiQuery(parameters): ApiQuery<JournalParameters>,
) -> Result<Json<Vec<JournalEntry>>, ErrorResponse> {
    let limit = checked_count("limit", parameters.limit, 200, MAX_ROWS)?;
    let filter = JournalFilter {
        device: parameters.device,
        kind: parameters.kind,
        since_ms: parameters.since,
        before_ms: parameters.before,
        limit: Some(limit as u32),
    };
    Ok(Json(app.daemon.view().journal(filter).await?))
}
