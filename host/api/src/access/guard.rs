//! Checks of every request before its route: host name, origin, role, duration.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use ihd_daemon::recording::EXPORT_TIMEOUT;
use ihd_model::{Problem, Role};

use super::cookie;
use super::hosts::AllowedHosts;
use super::served_tokens::ServedTokens;
use super::sessions::Sessions;
use crate::problem::refusal;
use crate::slots::Slot;

/// Maximum duration of a request until its response begins, reading its body included; the body of a response is not limited.
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_secs(20);

/// The same of a backup: copying a store of 2 GB takes longer than other requests.
pub(crate) const BACKUP_TIMEOUT: Duration = Duration::from_secs(600);

/// The same of a recording: its conversion to a table takes longer, too.
pub(crate) const RECORDING_TIMEOUT: Duration =
    EXPORT_TIMEOUT.saturating_add(Duration::from_secs(30));

/// Prefix of the page's files, which need no token.
const PAGE: &str = "/page/";

/// Path of browser sessions.
const SESSION: &str = "/api/v1/session";

/// Access control of a server.
pub(crate) struct Access {
    pub(crate) hosts: AllowedHosts,
    /// `None` on loopback without a token file: each local user has access.
    pub(crate) tokens: Option<ServedTokens>,
    /// Sessions of browsers that have presented a token.
    pub(crate) sessions: Sessions,
}

impl Access {
    /// Returns the tokens as their file has them now; a changed file ends all sessions. `None` if none is needed.
    pub(crate) fn present_tokens(&self) -> Option<&ServedTokens> {
        let tokens = self.tokens.as_ref()?;
        if tokens.refresh() {
            self.sessions.close_all();
        }
        Some(tokens)
    }

    /// Returns the role of a request with these headers; `None` if a token is required and no valid one is present.
    pub(crate) fn role(&self, headers: &HeaderMap) -> Option<Role> {
        let Some(tokens) = self.present_tokens() else {
            return Some(Role::Operate);
        };
        // The header outranks the cookie.
        match headers.get(AUTHORIZATION) {
            Some(header) => tokens.role(bearer(header)?),
            None => cookie::keys(headers).find_map(|key| self.sessions.role(key)),
        }
    }

    /// Checks that a request with these headers has the role.
    ///
    /// # Errors
    /// The response to send instead: 401 or 403.
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

/// Rejects requests whose `Host` is no name of this machine.
pub(crate) async fn check_host(
    State(access): State<Arc<Access>>,
    request: Request,
    next: Next,
) -> Response {
    let (parts, body) = request.into_parts();
    if !access.hosts.allows(&parts) {
        return refusal(
            StatusCode::MISDIRECTED_REQUEST,
            "host",
            "this machine does not go by that name: call it by its address, or add the name to `allowed_hosts`",
        );
    }
    next.run(Request::from_parts(parts, body)).await
}

/// Rejects requests of other sites' scripts, reads included. Following a link from another site is allowed.
pub(crate) async fn check_origin(request: Request, next: Next) -> Response {
    if is_foreign_script(request.headers()) {
        return cross_site_refused();
    }
    next.run(request).await
}

fn is_foreign_script(headers: &HeaderMap) -> bool {
    let header = |name| headers.get(name).map(HeaderValue::as_bytes);
    let foreign = matches!(header("sec-fetch-site"), Some(b"cross-site" | b"same-site"));
    foreign && header("sec-fetch-mode") != Some(b"navigate")
}

/// Returns the response to a request of another site's page.
pub(crate) fn cross_site_refused() -> Response {
    refusal(
        StatusCode::FORBIDDEN,
        "cross-site",
        "another site's page may not ask this",
    )
}

/// Rejects requests without the required role; admits the connection of one that has any role.
pub(crate) async fn check_role(
    State(access): State<Arc<Access>>,
    request: Request,
    next: Next,
) -> Response {
    let slot = request.extensions().get::<Slot>();
    if let Some(slot) = slot.filter(|_| access.role(request.headers()).is_some()) {
        slot.admit();
    }
    let Some(needed) = required_role(request.method(), request.uri().path()) else {
        return next.run(request).await;
    };
    match access.allow(request.headers(), needed) {
        Ok(()) => next.run(request).await,
        Err(response) => *response,
    }
}

/// Returns the role that a request requires: read for `GET` and `HEAD`, else operate. `None` for requests that need no token: `/healthz`,
/// for service managers; the page, which asks for the token; opening and closing a session.
pub(crate) fn required_role(method: &Method, path: &str) -> Option<Role> {
    let reads = matches!(*method, Method::GET | Method::HEAD);
    let opens_or_closes = matches!(*method, Method::POST | Method::DELETE);
    match path {
        "/healthz" | "/" if reads => None,
        page if reads && page.starts_with(PAGE) => None,
        SESSION if opens_or_closes => None,
        _ if reads => Some(Role::Read),
        _ => Some(Role::Operate),
    }
}

/// Ends requests that take too long, so that their connections can be evicted.
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
    use std::path::Path;

    use super::super::tokens::Tokens;
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

    fn access(tokens: Option<ServedTokens>) -> Access {
        Access {
            hosts: AllowedHosts::new([127, 0, 0, 1].into(), &[]),
            tokens,
            sessions: Sessions::default(),
        }
    }

    #[test]
    fn without_tokens_the_local_machine_may_operate() {
        let access = access(None);
        assert_eq!(status(&access, None, Role::Read), 200);
        assert_eq!(status(&access, None, Role::Operate), 200);
    }

    #[test]
    fn a_token_is_good_for_its_role_and_those_below() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tokens");
        let (tokens, _) = ServedTokens::load(&path).unwrap();
        let given = Role::ALL.map(|role| bearer_of(&path, role));
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

    /// The header with the token of a role in a file.
    fn bearer_of(path: &Path, role: Role) -> String {
        let tokens = Tokens::read(path).unwrap();
        format!("Bearer {}", tokens.at_least(role).unwrap())
    }

    #[test]
    fn a_token_taken_out_of_its_file_ends_with_its_sessions() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tokens");
        let (tokens, _) = ServedTokens::load(&path).unwrap();
        let [read, operate] = Role::ALL.map(|role| bearer_of(&path, role));
        let access = access(Some(tokens));
        let session = access.sessions.open(Role::Operate).unwrap();
        assert_eq!(status(&access, Some(&operate), Role::Operate), 200);

        let all = std::fs::read_to_string(&path).unwrap();
        let left: String = all
            .lines()
            .filter(|line| !line.starts_with("operate"))
            .map(|line| format!("{line}\n"))
            .collect();
        std::fs::write(&path, left).unwrap();
        assert_eq!(status(&access, Some(&operate), Role::Read), 401);
        assert_eq!(status(&access, Some(&read), Role::Read), 200);
        assert_eq!(access.sessions.role(&session), None);

        // What cannot be used changes nothing.
        std::fs::write(&path, "none of it\n").unwrap();
        assert_eq!(status(&access, Some(&read), Role::Read), 200);
    }
}
