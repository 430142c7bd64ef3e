//! The routes, and what lies in front of them.

mod devices;
mod events;
mod fleet;
mod health;
mod hob;
mod live;
mod page;
mod past;
pub(crate) mod problem;
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
use tokio::sync::{Semaphore, watch};
use tower_http::csrf::CsrfLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::access::guard::{self, Access};
use crate::backend::Backend;
use crate::places::Places;
use problem::refusal;

/// Largest body of a request, in bytes; a lookup as JSON takes 3 kB.
pub(crate) const MAX_BODY_BYTES: usize = 65_536;

/// Most watchers of events at a time: places of other connections are left for other requests.
pub(crate) const MAX_WATCHERS: usize = 64;

/// What the routes share.
pub(crate) struct App {
    pub(crate) backend: Arc<dyn Backend>,
    pub(crate) access: Access,
    /// Whether TLS is spoken.
    pub(crate) tls: bool,
    /// Where backups go.
    pub(crate) backups: PathBuf,
    /// True when the server ends.
    pub(crate) stopping: watch::Receiver<bool>,
    pub(crate) watchers: Arc<Semaphore>,
    pub(crate) counts: Counts,
    pub(crate) places: Places,
}

/// What the server counts.
#[derive(Default)]
pub(crate) struct Counts {
    /// Connections that were accepted.
    pub(crate) connections: AtomicU64,
    /// Notices that slow watchers missed.
    pub(crate) missed: AtomicU64,
}

#[derive(OpenApi)]
#[openapi(info(
    title = "ihd",
    description = "The daemon of ihd: induction hobs that are watched, taught and commanded. \
                   Commands name who asks in the header `ihd-holder`. Errors are a Problem.",
    version = "1",
    license(name = "MIT OR Apache-2.0")
))]
struct Description;

/// The routes and their description.
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
        .routes(routes!(health::metrics))
        .split_for_parts();
    // The macro takes the crate's version and licence for the API's.
    openapi.info.contact = None;
    (router, openapi)
}

/// The API's description.
#[utoipa::path(get, path = "/openapi.json", tag = "daemon",
    responses((status = 200, description = "This document", body = serde_json::Value)))]
async fn description() -> Json<utoipa::openapi::OpenApi> {
    Json(described().1)
}

/// Everything, guarded.
pub(crate) fn router(app: Arc<App>) -> Router {
    described()
        .0
        .route("/", get(page::index))
        .route("/page/{*path}", get(page::file))
        .fallback(not_found)
        .method_not_allowed_fallback(wrong_method)
        // From here outwards: the last is what a request meets first.
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(page::compression())
        .layer(from_fn(guard::deadline))
        .layer(from_fn_with_state(app.clone(), guard::role))
        .layer(CsrfLayer::new().with_rejection_response(|_| guard::cross_site()))
        .layer(from_fn(guard::foreign_page))
        .layer(from_fn_with_state(app.clone(), guard::host))
        .layer(from_fn(page::protect))
        .with_state(app)
}

async fn not_found() -> Response {
    nothing_here()
}

fn nothing_here() -> Response {
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
