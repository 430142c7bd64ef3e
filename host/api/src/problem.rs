//! Error responses, and extractors whose rejections are such responses.

use axum::Json;
use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::StatusCode;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};
use ihd_daemon::DaemonError;
use ihd_model::{CommandError, HOLDER_HEADER, Problem};
use serde::de::DeserializeOwned;

/// Returns an error response.
pub(crate) fn refusal(status: StatusCode, error: &str, message: &str) -> Response {
    (status, Json(Problem::new(error, message))).into_response()
}

/// Error of a route, as a response.
pub(crate) struct ErrorResponse(pub(crate) StatusCode, pub(crate) Problem);

impl ErrorResponse {
    pub(crate) fn new(status: StatusCode, error: &str, message: impl Into<String>) -> Self {
        Self(status, Problem::new(error, message))
    }

    pub(crate) fn no_device(name: &str) -> Self {
        CommandError::NoDevice { name: name.into() }.into()
    }
}

impl IntoResponse for ErrorResponse {
    fn into_response(self) -> Response {
        (self.0, Json(self.1)).into_response()
    }
}

impl From<CommandError> for ErrorResponse {
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

impl From<DaemonError> for ErrorResponse {
    /// Converts an error of a query. Errors of the store contain file names, which go to the log only.
    fn from(error: DaemonError) -> Self {
        if let DaemonError::NoDevice(name) = &error {
            return Self::no_device(name);
        }
        tracing::warn!(%error, "a request failed");
        let why = "the store could not do that; the daemon's log says why".into();
        CommandError::Failed { why }.into()
    }
}

/// Request body in JSON.
pub(crate) struct JsonBody<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for JsonBody<T> {
    type Rejection = ErrorResponse;

    async fn from_request(request: Request, state: &S) -> Result<Self, ErrorResponse> {
        match Json::<T>::from_request(request, state).await {
            Ok(Json(body)) => Ok(Self(body)),
            Err(rejection) => Err(body_problem(&rejection)),
        }
    }
}

fn body_problem(rejection: &JsonRejection) -> ErrorResponse {
    let status = rejection.status();
    let error = match status {
        StatusCode::PAYLOAD_TOO_LARGE => "too-large",
        StatusCode::UNSUPPORTED_MEDIA_TYPE => "content-type",
        _ => "body",
    };
    ErrorResponse::new(status, error, rejection.body_text())
}

/// Name in the path.
pub(crate) struct PathName(pub(crate) String);

impl<S: Send + Sync> FromRequestParts<S> for PathName {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ErrorResponse> {
        match Path::<String>::from_request_parts(parts, state).await {
            Ok(Path(name)) => Ok(Self(name)),
            Err(rejection) => {
                let text = rejection.body_text();
                Err(ErrorResponse::new(rejection.status(), "path", text))
            }
        }
    }
}

/// Query parameters.
pub(crate) struct ApiQuery<T>(pub(crate) T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ErrorResponse> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(parameters)) => Ok(Self(parameters)),
            Err(rejection) => Err(query_problem(&rejection)),
        }
    }
}

fn query_problem(rejection: &QueryRejection) -> ErrorResponse {
    ErrorResponse::new(rejection.status(), "query", rejection.body_text())
}

/// Name of the client, from the header [`HOLDER_HEADER`].
pub(crate) struct Holder(pub(crate) String);

/// Maximum length of a client name, in characters.
const MAX_HOLDER: usize = 64;

impl<S: Send + Sync> FromRequestParts<S> for Holder {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ErrorResponse> {
        let name = parts
            .headers
            .get(HOLDER_HEADER)
            .and_then(|value| value.to_str().ok())
            .map(str::trim)
            .filter(|name| (1..=MAX_HOLDER).contains(&name.len()));
        match name {
            Some(name) => Ok(Self(name.into())),
            None => Err(ErrorResponse::new(
                StatusCode::BAD_REQUEST,
                "holder",
                "the header `ihd-holder` must say who asks, in 1 to 64 printable ASCII characters",
            )),
        }
    }
}
