//! Browser sessions: a token is exchanged for a cookie.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::SET_COOKIE;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{AppendHeaders, IntoResponse, Response};
use ihd_model::{Problem, Role, SessionReport, SessionRequest};

use super::App;
use crate::access::cookie;
use crate::problem::{ErrorResponse, JsonBody};

/// Returns the rights of the client.
#[utoipa::path(get, path = "/session", tag = "session",
    responses((status = 200, body = SessionReport),
        (status = 401, description = "A token is needed", body = Problem)))]
pub(super) async fn session(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
) -> Result<Json<SessionReport>, ErrorResponse> {
    // The guard has rejected requests without a role.
    let role = app.access.role(&headers).unwrap_or(Role::Read);
    let token_needed = app.access.tokens.is_some();
    let fleet = app.daemon.fleet().report().is_some();
    Ok(Json(SessionReport {
        role,
        token_needed,
        fleet,
    }))
}

/// Opens a session with the role of a token and sets its cookie. The session ends when it is closed, when it was not used for 12 h, or with
/// the daemon. No cookie is set if the daemon requires no tokens.
#[utoipa::path(post, path = "/session", tag = "session", request_body = SessionRequest,
    responses((status = 204), (status = 401, description = "The token is not valid", body = Problem)))]
pub(super) async fn open(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    JsonBody(request): JsonBody<SessionRequest>,
) -> Result<Response, ErrorResponse> {
    let Some(tokens) = app.access.present_tokens() else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    let Some(role) = tokens.role(request.token.trim()) else {
        let text = "this token is not known here; the daemon's token file has those that are";
        return Err(ErrorResponse::new(StatusCode::UNAUTHORIZED, "token", text));
    };
    let key = app.access.sessions.open(role).map_err(|error| {
        ErrorResponse::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "session",
            error.to_string(),
        )
    })?;
    close_sessions(&app, &headers);
    Ok(with_cookie(&cookie::set_header(&key, app.tls.is_some())))
}

/// Closes the sessions of a request.
fn close_sessions(app: &App, headers: &HeaderMap) {
    for key in cookie::keys(headers) {
        app.access.sessions.close(key);
    }
}

/// Closes the session; copies of its cookie become invalid, too.
#[utoipa::path(delete, path = "/session", tag = "session", responses((status = 204)))]
pub(super) async fn close(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    close_sessions(&app, &headers);
    with_cookie(&cookie::delete_header(app.tls.is_some()))
}

fn with_cookie(text: &str) -> Response {
    match HeaderValue::from_str(text) {
        Ok(mut cookie) => {
            // Excludes it from logs of headers.
            cookie.set_sensitive(true);
            let headers = AppendHeaders([(SET_COOKIE, cookie)]);
            (StatusCode::NO_CONTENT, headers).into_response()
        }
        // Does not occur: the value is hexadecimal.
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
