//! A browser that shows its token once: the cookie, and what it is good for.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::SET_COOKIE;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{AppendHeaders, IntoResponse, Response};

use super::App;
use super::problem::{Body, Failed};
use crate::access::{Role, cookie};
use crate::model::{Problem, SessionReport, SessionRequest};

/// What whoever asks may do.
#[utoipa::path(get, path = "/session", tag = "session",
    responses((status = 200, body = SessionReport),
        (status = 401, description = "A token is needed", body = Problem)))]
pub(super) async fn session(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
) -> Result<Json<SessionReport>, Failed> {
    // The guard has let in nobody without a role.
    let role = app.access.role(&headers).unwrap_or(Role::Read);
    let token_needed = app.access.tokens.is_some();
    let fleet = app.backend.fleet().is_some();
    Ok(Json(SessionReport {
        role,
        token_needed,
        fleet,
    }))
}

/// Shows a token, and gets the cookie of a session that has its role: until it is closed, nobody has used it for 12 h, or the daemon ends. Where no
/// token is needed, there is no cookie.
#[utoipa::path(post, path = "/session", tag = "session", request_body = SessionRequest,
    responses((status = 204), (status = 401, description = "The token is not known", body = Problem)))]
pub(super) async fn open(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    Body(request): Body<SessionRequest>,
) -> Result<Response, Failed> {
    let Some(tokens) = &app.access.tokens else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    let Some(role) = tokens.role(request.token.trim()) else {
        let text = "this token is not known here; the daemon's token file has those that are";
        return Err(Failed::new(StatusCode::UNAUTHORIZED, "token", text));
    };
    let key = app.access.sessions.open(role).map_err(|error| {
        Failed::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "session",
            error.to_string(),
        )
    })?;
    end(&app, &headers);
    Ok(with_cookie(&cookie::given(&key, app.tls)))
}

/// Ends the sessions that a request brings along.
fn end(app: &App, headers: &HeaderMap) {
    for key in cookie::keys(headers) {
        app.access.sessions.close(key);
    }
}

/// Ends the session: its cookie is good for nothing any more, whoever has it.
#[utoipa::path(delete, path = "/session", tag = "session", responses((status = 204)))]
pub(super) async fn close(State(app): State<Arc<App>>, headers: HeaderMap) -> Response {
    end(&app, &headers);
    with_cookie(&cookie::taken_back(app.tls))
}

fn with_cookie(text: &str) -> Response {
    match HeaderValue::from_str(text) {
        Ok(mut cookie) => {
            // Whatever logs headers leaves this one out.
            cookie.set_sensitive(true);
            let headers = AppendHeaders([(SET_COOKIE, cookie)]);
            (StatusCode::NO_CONTENT, headers).into_response()
        }
        // Its value is encoded: it has no byte that a header cannot hold.
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
