//! What the store has of a device, as a display wants it: history, windows, fits, maps; and the journal.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use ihd_daemon::JournalFilter;
use ihd_daemon::board::now_ms;
use ihd_daemon::model::{
    Fit, History, JournalEntry, Map, PotCurve, Scope, WindowSummary, WindowWanted,
};
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use super::problem::{Asked, Failed};
use crate::model::Problem;

/// Columns of a history, unless told otherwise.
const HISTORY_COLUMNS: u32 = 600;

/// Columns of a window, unless told otherwise.
const WINDOW_COLUMNS: u32 = 1_200;

/// No display is wider.
const MAX_COLUMNS: u32 = 4_000;

/// How far back a history reaches, unless told otherwise.
const HISTORY_MS: i64 = 300_000;

/// Most rows in an answer.
const MAX_ROWS: u32 = 10_000;

/// A number that was asked for, or what it is without a word; an error outside of 1 to `most`.
fn within(name: &str, asked: Option<u32>, otherwise: u32, most: u32) -> Result<usize, Failed> {
    match asked.unwrap_or(otherwise) {
        n if (1..=most).contains(&n) => Ok(n as usize),
        n => Err(wrong(format!(
            "{name} is {n}, but must lie between 1 and {most}"
        ))),
    }
}

fn wrong(text: String) -> Failed {
    Failed::new(StatusCode::BAD_REQUEST, "query", text)
}

/// Which stretch of time.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichHistory {
    /// Where it begins, in milliseconds since 1970, UTC; 5 minutes before its end unless told.
    from: Option<i64>,
    /// Where it ends; now unless told.
    to: Option<i64>,
    /// At most so many columns, 1 to 4000; 600 unless told.
    columns: Option<u32>,
}

/// What a device did, over minutes to months, in columns of a display.
#[utoipa::path(get, path = "/devices/{name}/history", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), WhichHistory),
    responses((status = 200, body = History), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn history(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(which): Asked<WhichHistory>,
) -> Result<Json<History>, Failed> {
    let columns = within("columns", which.columns, HISTORY_COLUMNS, MAX_COLUMNS)?;
    let to_ms = which.to.unwrap_or_else(now_ms);
    let from_ms = which.from.unwrap_or(to_ms.saturating_sub(HISTORY_MS));
    if from_ms >= to_ms {
        return Err(wrong(format!(
            "from is {from_ms} and to is {to_ms}: from must lie before to"
        )));
    }
    let history = app.backend.history(&name, from_ms, to_ms, columns);
    Ok(Json(history.await?))
}

/// How much warmer the pot is than when it was put on, over the last hour, with its standard deviation. Never an absolute
/// temperature, never an input of protection.
#[utoipa::path(get, path = "/devices/{name}/pot-temperature", tag = "past",
    params(("name" = String, Path, description = "Name of the device")),
    responses((status = 200, body = PotCurve), (status = 404, body = Problem)))]
pub(super) async fn pot_temperature(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
) -> Result<Json<PotCurve>, Failed> {
    let curve = app.backend.pot_curve(&name);
    Ok(Json(curve.ok_or_else(|| Failed::no_device(&name))?))
}

/// How many.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HowMany {
    /// At most so many, 1 to 10 000; unless told 100 windows, 50 fits.
    limit: Option<u32>,
}

/// Windows that the store has of a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/windows", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), HowMany),
    responses((status = 200, body = [WindowSummary]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn windows(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(how): Asked<HowMany>,
) -> Result<Json<Vec<WindowSummary>>, Failed> {
    let limit = within("limit", how.limit, 100, MAX_ROWS)?;
    Ok(Json(app.backend.windows(&name, limit).await?))
}

/// Which window, and how much of it.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichWindow {
    /// Boot of the device, with `seq`; without both the newest that has samples.
    boot: Option<u32>,
    /// Number of the window since that boot.
    seq: Option<u32>,
    /// Where the view begins, in seconds after the window's first pair; its beginning unless told.
    from_s: Option<f64>,
    /// Where the view ends; its end unless told.
    to_s: Option<f64>,
    /// At most so many columns, 1 to 4000; 1200 unless told.
    columns: Option<u32>,
}

impl WhichWindow {
    fn wanted(&self) -> Result<WindowWanted, Failed> {
        let columns = within("columns", self.columns, WINDOW_COLUMNS, MAX_COLUMNS)?;
        let which = match (self.boot, self.seq) {
            (Some(boot), Some(seq)) => Some((boot, seq)),
            (None, None) => None,
            _ => return Err(wrong("boot and seq go together".into())),
        };
        let (from_s, to_s) = (
            self.from_s.unwrap_or(0.0),
            self.to_s.unwrap_or(f64::INFINITY),
        );
        // Neither is true of NaN.
        if !(from_s.is_finite() && from_s < to_s) {
            return Err(wrong(format!(
                "from_s is {from_s} and to_s is {to_s}: from_s must lie before to_s"
            )));
        }
        Ok(WindowWanted {
            which,
            from_s,
            to_s,
            columns,
        })
    }
}

/// Voltage and current of a window as a scope shows them, and R and L over it.
#[utoipa::path(get, path = "/devices/{name}/window", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), WhichWindow),
    responses((status = 200, body = Scope), (status = 400, body = Problem),
        (status = 404, description = "No such device, or no such window with samples", body = Problem)))]
pub(super) async fn window(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(which): Asked<WhichWindow>,
) -> Result<Json<Scope>, Failed> {
    let scope = app.backend.scope(&name, which.wanted()?).await?;
    scope.map(Json).ok_or_else(|| {
        let text = "the store has no such window with its samples: the device has not heated yet, or `keep` dropped it";
        Failed::new(StatusCode::NOT_FOUND, "no-window", text)
    })
}

/// How the network came to what it says of a device, newest first.
#[utoipa::path(get, path = "/devices/{name}/training", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), HowMany),
    responses((status = 200, body = [Fit]), (status = 400, body = Problem),
        (status = 404, body = Problem)))]
pub(super) async fn training(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(how): Asked<HowMany>,
) -> Result<Json<Vec<Fit>>, Failed> {
    let limit = within("limit", how.limit, 50, MAX_ROWS)?;
    Ok(Json(app.backend.training(&name, limit).await?))
}

/// Which lookup.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichMap {
    /// Its version; 0 is the built-in one. That of the device unless told.
    version: Option<u32>,
}

/// A lookup in ohm and henry, with what each cell rests on.
#[utoipa::path(get, path = "/devices/{name}/map", tag = "past",
    params(("name" = String, Path, description = "Name of the device"), WhichMap),
    responses((status = 200, body = Map), (status = 400, body = Problem),
        (status = 404, description = "No such device or version", body = Problem)))]
pub(super) async fn map(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    Asked(which): Asked<WhichMap>,
) -> Result<Json<Map>, Failed> {
    let map = app.backend.map(&name, which.version).await?;
    map.map(Json).ok_or_else(|| {
        let text = match which.version {
            Some(version) => format!("the store has no lookup of version {version} of {name}; its lookups list those that there are"),
            None => format!("it is not known which lookup {name} uses; version=0 is the built-in one"),
        };
        Failed::new(StatusCode::NOT_FOUND, "no-version", text)
    })
}

/// Which of what happened.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichEntries {
    /// Of this device; of all where it is left out.
    device: Option<String>,
    /// Of this kind: `fault`, `pot`, `state`, `command`, …
    kind: Option<String>,
    /// None before this, in milliseconds since 1970, UTC.
    since: Option<i64>,
    /// Only before this: the `at_ms` of the last entry of a page gives the next.
    before: Option<i64>,
    /// At most so many, 1 to 10 000; 200 unless told.
    limit: Option<u32>,
}

/// What happened and what was commanded, newest first.
#[utoipa::path(get, path = "/journal", tag = "past", params(WhichEntries),
    responses((status = 200, body = [JournalEntry]), (status = 400, body = Problem)))]
pub(super) async fn journal(
    State(app): State<Arc<App>>,
    Asked(which): Asked<WhichEntries>,
) -> Result<Json<Vec<JournalEntry>>, Failed> {
    let limit = within("limit", which.limit, 200, MAX_ROWS)?;
    let filter = JournalFilter {
        device: which.device,
        kind: which.kind,
        since_ms: which.since,
        before_ms: which.before,
        limit: Some(limit as u32),
    };
    Ok(Json(app.backend.journal(filter).await?))
}
