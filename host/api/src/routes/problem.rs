//! Errors as answers, and bodies that are read with errors of the same kind.

use axum::Json;
use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::StatusCode;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};
use ihd_daemon::model::CommandError;
use serde::de::DeserializeOwned;

use crate::model::{HOLDER_HEADER, Problem};

/// An answer that refuses.
pub(crate) fn refusal(status: StatusCode, error: &str, message: &str) -> Response {
    (status, Json(Problem::new(error, message))).into_response()
}

/// A refusal or failure of a route.
pub(crate) struct Failed(pub(crate) StatusCode, pub(crate) Problem);

impl Failed {
    pub(crate) fn new(status: StatusCode, error: &str, message: impl Into<String>) -> Self {
        Self(status, Problem::new(error, message))
    }

    pub(crate) fn no_device(name: &str) -> Self {
        CommandError::NoDevice { name: name.into() }.into()
    }
}

impl IntoResponse for Failed {
    fn into_response(self) -> Response {
        (self.0, Json(self.1)).into_response()
    }
}

impl From<CommandError> for Failed {
    fn from(error: CommandError) -> Self {
        let status = match &error {
            CommandError::NoDevice { .. } => StatusCode::NOT_FOUND,
            CommandError::NotConnected { .. } => StatusCode::SERVICE_UNAVAILABLE,
            CommandError::Leased { .. } => StatusCode::LOCKED,
            CommandError::Refused { .. } => StatusCode::CONFLICT,
            CommandError::Failed { .. } => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self(status, Problem::from(&error))
    }
}

/// A body in JSON.
pub(crate) struct Body<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Failed;

    async fn from_request(request: Request, state: &S) -> Result<Self, Failed> {
        match Json::<T>::from_request(request, state).await {
            Ok(Json(body)) => Ok(Self(body)),
            Err(why) => Err(body_problem(&why)),
        }
    }
}

fn body_problem(why: &JsonRejection) -> Failed {
    let status = why.status();
    let error = match status {
        StatusCode::PAYLOAD_TOO_LARGE => "too-large",
        StatusCode::UNSUPPORTED_MEDIA_TYPE => "content-type",
        _ => "body",
    };
    Failed::new(status, error, why.body_text())
}

/// What stands behind the question mark.
pub(crate) struct Asked<T>(pub(crate) T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Asked<T> {
    type Rejection = Failed;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Failed> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(asked)) => Ok(Self(asked)),
            Err(why) => Err(query_problem(&why)),
        }
    }
}

fn query_problem(why: &QueryRejection) -> Failed {
    Failed::new(why.status(), "query", why.body_text())
}

/// Who asks, by the header [`HOLDER_HEADER`].
pub(crate) struct Holder(pub(crate) String);

/// Longest name of a holder.
const MAX_HOLDER: usize = 64;

impl<S: Send + Sync> FromRequestParts<S> for Holder {
    type Rejection = Failed;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Failed> {
        let name = parts
            .headers
            .get(HOLDER_HEADER)
            .and_then(|value| value.to_str().ok())
            .map(str::trim)
            .filter(|name| (1..=MAX_HOLDER).contains(&name.len()));
        match name {
            Some(name) => Ok(Self(name.into())),
            None => Err(Failed::new(
                StatusCode::BAD_REQUEST,
                "holder",
                "the header `ihd-holder` must say who asks, in 1 to 64 printable ASCII characters",
            )),
        }
    }
}
