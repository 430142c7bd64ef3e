//! Errors of requests to a daemon.

use ihd_model::{CommandError, Problem};
use thiserror::Error;

/// Error of a request to a daemon.
#[derive(Debug, Error)]
pub enum ClientError {
    /// Error of the daemon.
    #[error("{0}")]
    Command(CommandError),
    /// The API server refused the request.
    #[error("the daemon at {url} refused: {}", problem.message)]
    Refused {
        /// URL of the daemon.
        url: String,
        /// HTTP status.
        status: u16,
        /// Error in the response.
        problem: Problem,
    },
    /// There is no response.
    #[error("no answer from the daemon at {url}: {why}")]
    Unreachable {
        /// URL of the daemon.
        url: String,
        /// Reason.
        why: String,
    },
    /// The response is not one of a daemon of this version.
    #[error("{url} does not answer as a daemon of this version: {why}")]
    UnexpectedResponse {
        /// URL of the daemon.
        url: String,
        /// Reason.
        why: String,
    },
    /// The certificate file cannot be used.
    #[error("certificate {path}: {why}")]
    Certificate {
        /// The file.
        path: String,
        /// Reason.
        why: String,
    },
    /// What came cannot be written on this machine.
    #[error("{file} cannot be written here: {why}")]
    Write {
        /// Name of the recording.
        file: String,
        /// Reason.
        why: String,
    },
}
