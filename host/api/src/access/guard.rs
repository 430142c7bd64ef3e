//! What every request passes before a route sees it.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::hosts::AllowedHosts;
use super::sessions::Sessions;
use super::tokens::Tokens;
use super::{Role, cookie};
use crate::model::Problem;
use crate::places::Place;
use crate::routes::App;
use crate::routes::problem::refusal;

/// Longest that a request may take, its body included; events stream for as long as they like.
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_secs(20);

/// Copying a store of 2 GB takes longer than other requests.
pub(crate) const BACKUP_TIMEOUT: Duration = Duration::from_secs(600);

/// Making a table of a recording, too; its download is not cut off.
pub(crate) const RECORDING_TIMEOUT: Duration = Duration::from_secs(330);

/// Below this lie the page's files, which are the same for everybody.
const PAGE: &str = "/page/";

/// Where a browser shows its token.
const SESSION: &str = "/api/v1/session";

/// Who may come in.
pub(crate) struct Access {
    pub(crate) hosts: AllowedHosts,
    /// None on loopback without a token file: there the machine is the fence.
    pub(crate) tokens: Option<Tokens>,
    /// Sessions of browsers that showed a token.
    pub(crate) sessions: Sessions,
}

impl Access {
    /// The role of whoever sends these headers; none where a token is needed, and none that is known is there.
    pub(crate) fn role(&self, headers: &HeaderMap) -> Option<Role> {
        let Some(tokens) = &self.tokens else {
            return Some(Role::Operate);
        };
        // Whoever shows a token in the header means that one.
        match headers.get(AUTHORIZATION) {
            Some(header) => tokens.role(bearer(header)?),
            None => cookie::keys(headers).find_map(|key| self.sessions.role(key)),
        }
    }

    /// Whether whoever sends these headers has the role.
    fn allow(&self, headers: &HeaderMap, needed: Role) -> Result<(), Box<Response>> {
        match self.role(headers) {
            None => {
                let header = headers.get(AUTHORIZATION);
                let given = header.is_some_and(|header| bearer(header).is_some())
                    || cookie::keys(headers).next().is_some();
                Err(token_missing(given))
            }
            Some(role) if role < needed => Err(role_missing(needed)),
            Some(_) => Ok(()),
        }
    }
}

fn bearer(header: &HeaderValue) -> Option<&str> {
    let (scheme, token) = header.to_str().ok()?.split_once(' ')?;
    let token = token.trim();
    scheme.eq_ignore_ascii_case("bearer").then_some(token)
}

fn token_missing(given: bool) -> Box<Response> {
    let text = if given {
        "this token is not known here, or this session has ended"
    } else {
        "a token is needed: send `Authorization: Bearer TOKEN`, or show it to /api/v1/session once"
    };
    let mut response = refusal(StatusCode::UNAUTHORIZED, "token", text);
    let bearer = HeaderValue::from_static("Bearer");
    response.headers_mut().insert(WWW_AUTHENTICATE, bearer);
    Box::new(response)
}

fn role_missing(needed: Role) -> Box<Response> {
    let text = format!("this needs the role {}", needed.name());
    Box::new(refusal(StatusCode::FORBIDDEN, "role", &text))
}

/// Turns away requests to a name that is not this machine's.
pub(crate) async fn host(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let (parts, body) = request.into_parts();
    if !app.access.hosts.allows(&parts) {
        return refusal(
            StatusCode::MISDIRECTED_REQUEST,
            "host",
            "this machine does not go by that name: call it by its address, or add the name to `allowed_hosts`",
        );
    }
    next.run(Request::from_parts(parts, body)).await
}

/// Turns away what other pages' scripts ask for, reading included; a link that is followed passes.
pub(crate) async fn foreign_page(request: Request, next: Next) -> Response {
    if is_foreign_script(request.headers()) {
        return cross_site();
    }
    next.run(request).await
}

fn is_foreign_script(headers: &HeaderMap) -> bool {
    let header = |name| headers.get(name).map(HeaderValue::as_bytes);
    let foreign = matches!(header("sec-fetch-site"), Some(b"cross-site" | b"same-site"));
    foreign && header("sec-fetch-mode") != Some(b"navigate")
}

/// The answer to another page.
pub(crate) fn cross_site() -> Response {
    refusal(
        StatusCode::FORBIDDEN,
        "cross-site",
        "another site's page may not ask this",
    )
}

/// Turns away who lacks the role.
pub(crate) async fn role(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let place = request.extensions().get::<Place>();
    if let Some(place) = place.filter(|_| app.access.role(request.headers()).is_some()) {
        place.is_let_in();
    }
    let Some(needed) = needed(request.method(), request.uri().path()) else {
        return next.run(request).await;
    };
    match app.access.allow(request.headers(), needed) {
        Ok(()) => next.run(request).await,
        Err(response) => *response,
    }
}

/// The role that a request needs: looking needs read, everything else operate. None for what is open to everybody: the health,
/// which a service manager asks for, the page, without which nobody could show a token, and showing and forgetting it.
fn needed(method: &Method, path: &str) -> Option<Role> {
    let looks = matches!(*method, Method::GET | Method::HEAD);
    let shows = matches!(*method, Method::POST | Method::DELETE);
    match path {
        "/healthz" | "/" if looks => None,
        page if looks && page.starts_with(PAGE) => None,
        SESSION if shows => None,
        _ if looks => Some(Role::Read),
        _ => Some(Role::Operate),
    }
}

/// Ends what takes too long, so that nobody holds a place for ever.
pub(crate) async fn deadline(request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let limit = if path.ends_with("/store/backup") {
        BACKUP_TIMEOUT
    } else if path.starts_with("/api/v1/recordings/") {
        RECORDING_TIMEOUT
    } else {
        REQUEST_TIMEOUT
    };
    match tokio::time::timeout(limit, next.run(request)).await {
        Ok(response) => response,
        Err(_) => {
            let text = format!(
                "not done within {} s; whether it still happens, the device's status will show",
                limit.as_secs()
            );
            let problem = Problem::new("time-out", text);
            (StatusCode::GATEWAY_TIMEOUT, axum::Json(problem)).into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(access: &Access, header: Option<&str>, needed: Role) -> u16 {
        let mut headers = HeaderMap::new();
        if let Some(header) = header {
            headers.insert(AUTHORIZATION, header.parse().unwrap());
        }
        match access.allow(&headers, needed) {
            Ok(()) => 200,
            Err(response) => response.status().as_u16(),
        }
    }

    fn access(tokens: Option<Tokens>) -> Access {
        Access {
            hosts: AllowedHosts::new([127, 0, 0, 1].into(), &[]),
            tokens,
            sessions: Sessions::default(),
        }
    }

    #[test]
    fn without_tokens_the_local_machine_may_operate_and_not_flash() {
        let access = access(None);
        assert_eq!(status(&access, None, Role::Read), 200);
        assert_eq!(status(&access, None, Role::Operate), 200);
        assert_eq!(status(&access, None, Role::Flash), 403);
    }

    #[test]
    fn a_token_is_good_for_its_role_and_those_below() {
        let dir = tempfile::tempdir().unwrap();
        let (tokens, _) = Tokens::read_or_make(&dir.path().join("tokens")).unwrap();
        let of = |role| format!("Bearer {}", tokens.at_least(role).unwrap());
        let given = Role::ALL.map(of);
        let access = access(Some(tokens));
        for (has, header) in Role::ALL.into_iter().zip(&given) {
            for needed in Role::ALL {
                let expected = if has >= needed { 200 } else { 403 };
                assert_eq!(status(&access, Some(header), needed), expected);
            }
        }
        for wrong in [
            "Bearer ",
            "Bearer x",
            "Basic x",
            "x",
            &given[0].replace("Bearer", "Basic"),
        ] {
            assert_eq!(status(&access, Some(wrong), Role::Read), 401, "{wrong}");
        }
        assert_eq!(status(&access, None, Role::Read), 401);
    }
}
