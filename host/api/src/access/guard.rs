//! What every request passes before a route sees it.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::Role;
use super::hosts::AllowedHosts;
use super::tokens::Tokens;
use crate::model::Problem;
use crate::routes::App;
use crate::routes::problem::refusal;

/// Longest that a request may take, its body included; events stream for as long as they like.
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_secs(20);

/// Copying a store of 2 GB takes longer than other requests.
pub(crate) const BACKUP_TIMEOUT: Duration = Duration::from_secs(600);

/// The one route that needs no token: a service manager asks it.
const OPEN: &str = "/healthz";

/// Who may come in.
pub(crate) struct Access {
    pub(crate) hosts: AllowedHosts,
    /// None on loopback without a token file: there the machine is the fence.
    pub(crate) tokens: Option<Tokens>,
}

impl Access {
    /// Whether the bearer of these headers has the role.
    fn allow(&self, headers: &HeaderMap, needed: Role) -> Result<(), Box<Response>> {
        let Some(tokens) = &self.tokens else {
            return if needed <= Role::Operate {
                Ok(())
            } else {
                Err(role_missing(needed))
            };
        };
        let given = headers
            .get(AUTHORIZATION)
            .and_then(|value| value.to_str().ok())
            .and_then(|value| value.split_once(' '))
            .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
            .map(|(_, token)| token.trim());
        match given.and_then(|token| tokens.role(token)) {
            None => Err(token_missing(given.is_some())),
            Some(role) if role < needed => Err(role_missing(needed)),
            Some(_) => Ok(()),
        }
    }
}

fn token_missing(given: bool) -> Box<Response> {
    let text = if given {
        "this token is not known here"
    } else {
        "a token is needed: send `Authorization: Bearer TOKEN`"
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

/// Turns away who lacks the role: looking needs read, everything else operate.
pub(crate) async fn role(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let looks = matches!(*request.method(), Method::GET | Method::HEAD);
    let needed = if looks { Role::Read } else { Role::Operate };
    if looks && request.uri().path() == OPEN {
        return next.run(request).await;
    }
    match app.access.allow(request.headers(), needed) {
        Ok(()) => next.run(request).await,
        Err(response) => *response,
    }
}

/// Ends what takes too long, so that nobody holds a place for ever.
pub(crate) async fn deadline(request: Request, next: Next) -> Response {
    let backup = request.uri().path().ends_with("/store/backup");
    let limit = if backup {
        BACKUP_TIMEOUT
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
