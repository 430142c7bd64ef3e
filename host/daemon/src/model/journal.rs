//! What happened, as the store has it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Something that happened, or a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JournalEntry {
    /// Milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device; empty where the daemon itself speaks.
    pub device: String,
    /// A word for its kind: `fault`, `pot`, `state`, `command`, …
    pub kind: String,
    /// Who asked, for a command; empty otherwise.
    pub holder: String,
    /// What, in words; for a command what became of it too.
    pub text: String,
}
