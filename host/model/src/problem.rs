//! Error of a request.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::command::CommandError;

/// Error of a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// Error code: `no-device`, `leased`, `role`, …
    pub error: String,
    /// Description of the error and advice, for users.
    pub message: String,
    /// Further fields of the error: `holder`, `expires_in_s`, …
    #[serde(flatten)]
    pub fields: BTreeMap<String, serde_json::Value>,
}

impl Problem {
    /// Creates a problem without further fields.
    pub fn new(error: &str, message: impl Into<String>) -> Self {
        Self {
            error: error.into(),
            message: message.into(),
            fields: BTreeMap::new(),
        }
    }

    /// Returns the daemon's error; `None` if the server itself refused the request.
    pub fn command_error(&self) -> Option<CommandError> {
        serde_json::from_value(serde_json::to_value(self).ok()?).ok()
    }
}

impl From<&CommandError> for Problem {
    fn from(error: &CommandError) -> Self {
        let mut fields = match serde_json::to_value(error) {
            Ok(serde_json::Value::Object(fields)) => fields,
            _ => serde_json::Map::new(),
        };
        let code = match fields.remove("error") {
            Some(serde_json::Value::String(code)) => code,
            _ => "failed".into(),
        };
        Self {
            error: code,
            message: error.to_string(),
            fields: fields.into_iter().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_daemon_survives_the_way_to_the_client() {
        let error = CommandError::Leased {
            name: "bench".into(),
            holder: "Ada".into(),
            expires_in_s: 7,
        };
        let sent = serde_json::to_string(&Problem::from(&error)).unwrap();
        let problem: Problem = serde_json::from_str(&sent).unwrap();
        assert_eq!(problem.error, "leased");
        assert_eq!(problem.message, error.to_string());
        assert_eq!(problem.command_error(), Some(error));
    }

    #[test]
    fn a_refusal_of_the_server_is_no_error_of_the_daemon() {
        assert_eq!(Problem::new("role", "no").command_error(), None);
    }
}
