//! Routes, and the checks in front of them.

mod common_responses;
mod devices;
mod events;
mod fleet;
pub(crate) mod health;
mod hob;
mod live;
mod metrics;
mod page;
mod past;
mod recordings;
mod session;
mod store;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::Response;
use axum::routing::get;
use axum::{Json, Router};
use ihd_daemon::Daemon;
use tokio::sync::{Semaphore, watch};
use tower_http::csrf::CsrfLayer;
use utoipa::OpenApi;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::access::guard::{self, Access};
use crate::connection::MAX_BODY_BYTES;
use crate::problem::refusal;
use crate::routes::health::HealthCache;
use crate::served::ServedTls;
use crate::slots::ConnectionSlots;

/// Maximum number of simultaneous event streams; leaves connections for other requests.
pub(crate) const MAX_SUBSCRIBERS: usize = 64;

/// State shared by the routes.
pub(crate) struct App {
    pub(crate) daemon: Daemon,
    pub(crate) health: HealthCache,
    pub(crate) access: Arc<Access>,
    /// Certificate; `None` without TLS.
    pub(crate) tls: Option<ServedTls>,
    /// Folder for backups.
    pub(crate) backups: PathBuf,
    /// `true` once the server ends.
    pub(crate) stopping: watch::Receiver<bool>,
    /// A permit for each event stream.
    pub(crate) subscribers: Arc<Semaphore>,
    pub(crate) counts: Counts,
    pub(crate) slots: ConnectionSlots,
}

/// Counters of the server.
#[derive(Default)]
pub(crate) struct Counts {
    /// Accepted connections.
    pub(crate) connections: AtomicU64,
    /// Events that were dropped for slow subscribers.
    pub(crate) missed: AtomicU64,
}

#[derive(OpenApi)]
#[openapi(info(
    title = "ihd",
    description = "The daemon of ihd, which monitors and controls induction hobs and trains their lookups. \
                   Commands name the client in the header `ihd-holder`. Errors are a Problem.",
    version = "1",
    license(name = "MIT OR Apache-2.0")
))]
struct Description;

/// Returns the routes and their OpenAPI description.
pub(crate) fn described() -> (Router<Arc<App>>, utoipa::openapi::OpenApi) {
    let api = OpenApiRouter::new()
        .routes(routes!(devices::all))
        .routes(routes!(devices::one))
        .routes(routes!(devices::lookups))
        .routes(routes!(devices::results))
        .routes(routes!(past::history))
        .routes(routes!(past::windows))
        .routes(routes!(past::window))
        .routes(routes!(past::training))
        .routes(routes!(past::map))
        .routes(routes!(past::pot_temperature))
        .routes(routes!(past::journal))
        .routes(routes!(devices::command))
        .routes(routes!(devices::take_lease, devices::release_lease))
        .routes(routes!(events::events))
        .routes(routes!(recordings::all))
        .routes(routes!(recordings::one))
        .routes(routes!(live::live))
        .routes(routes!(hob::hob))
        .routes(routes!(fleet::fleet))
        .routes(routes!(session::session, session::open, session::close))
        .routes(routes!(store::backup))
        .routes(routes!(description));
    let (router, mut openapi) = OpenApiRouter::with_openapi(Description::openapi())
        .nest("/api/v1", api)
        .routes(routes!(health::healthz))
        .routes(routes!(metrics::metrics))
        .split_for_parts();
    // The derive macro takes contact from the crate's authors.
    openapi.info.contact = None;
    common_responses::add(&mut openapi);
    add_security(&mut openapi);
    (router, openapi)
}

/// Describes the token, which a daemon without a token file does not need.
fn add_security(openapi: &mut utoipa::openapi::OpenApi) {
    const TOKEN: &str = "token";
    let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build();
    let components = openapi.components.get_or_insert_default();
    components.add_security_scheme(TOKEN, SecurityScheme::Http(bearer));
    let needed = SecurityRequirement::new(TOKEN, [""; 0]);
    openapi.security = Some(vec![SecurityRequirement::default(), needed]);
}

/// Returns the OpenAPI description of this API.
#[utoipa::path(get, path = "/openapi.json", tag = "daemon",
    responses((status = 200, description = "This document", body = serde_json::Value)))]
async fn description() -> Json<utoipa::openapi::OpenApi> {
    Json(described().1)
}

/// Returns all routes with the checks in front of them.
pub(crate) fn router(app: Arc<App>) -> Router {
    let access = app.access.clone();
    described()
        .0
        .route("/", get(page::index))
        .route("/page/{*path}", get(page::file))
        .fallback(not_found)
        .method_not_allowed_fallback(wrong_method)
        // A request passes the last layer first.
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(page::compression())
        .layer(from_fn(guard::deadline))
        .layer(from_fn_with_state(access.clone(), guard::check_role))
        .layer(CsrfLayer::new().with_rejection_response(|_| guard::cross_site_refused()))
        .layer(from_fn(guard::check_origin))
        .layer(from_fn_with_state(access, guard::check_host))
        .layer(from_fn(page::protect))
        .with_state(app)
}

async fn not_found() -> Response {
    no_route()
}

fn no_route() -> Response {
    refusal(
        StatusCode::NOT_FOUND,
        "no-route",
        "there is nothing here; /api/v1/openapi.json lists what there is",
    )
}

async fn wrong_method() -> Response {
    refusal(
        StatusCode::METHOD_NOT_ALLOWED,
        "method",
        "not with this method; /api/v1/openapi.json lists what there is",
    )
}
