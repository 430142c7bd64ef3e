//! Journal: stored events and commands.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Event or command of the journal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JournalEntry {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Name of the device; empty for events of the daemon.
    pub device: String,
    /// Kind: `fault`, `pot`, `state`, `command`, …
    pub kind: String,
    /// Holder that issued a command; empty for events.
    pub holder: String,
    /// Description; for a command with its outcome.
    pub text: String,
}
