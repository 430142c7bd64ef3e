//! Errors of the server and of what `ihd-fleet init` makes on it.

/// Error of the server or of an object on it.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {why}")]
pub struct JetStreamError {
    /// Name of the stream, bucket or consumer.
    pub what: String,
    /// Error text.
    pub why: String,
}

impl JetStreamError {
    /// Creates it from an error of the client.
    pub fn new(what: &str, why: impl std::fmt::Display) -> Self {
        Self {
            what: what.to_owned(),
            why: why.to_string(),
        }
    }
}

/// Returns the conversion of an error that concerns `what`.
pub(super) fn failed<E: std::fmt::Display>(what: &str) -> impl FnOnce(E) -> JetStreamError + '_ {
    move |why| JetStreamError::new(what, why)
}

/// Returns the error of an object that `ihd-fleet init` makes.
pub(crate) fn missing(name: &str, why: impl std::fmt::Display) -> JetStreamError {
    let why = why.to_string();
    match why.contains("not found") {
        true => JetStreamError::new(
            name,
            "the server has none: `ihd-fleet init --url …` makes what a fleet needs",
        ),
        false => JetStreamError::new(name, why),
    }
}
