//! Journal: stored events and commands.

use ihd_model::JournalEntry;
use ihd_store::{JournalFilter, JournalRow};

use super::View;
use crate::error::DaemonError;

/// Largest number of entries in a response.
const MAX_ENTRIES: u32 = 10_000;

impl View {
    /// Returns events and commands, newest first, at most ten thousand. A client that continues with the entries before the
    /// time of the last one misses only further entries of that millisecond.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn journal(&self, filter: JournalFilter) -> Result<Vec<JournalEntry>, DaemonError> {
        let filter = JournalFilter {
            limit: filter.limit.map(|limit| limit.min(MAX_ENTRIES)),
            ..filter
        };
        let rows = self.read(move |reader| reader.journal(&filter)).await?;
        Ok(rows.into_iter().map(entry).collect())
    }
}

fn entry(row: JournalRow) -> JournalEntry {
    let text = match row.outcome.as_str() {
        "" => row.text,
        outcome => format!("{}: {outcome}", row.text),
    };
    JournalEntry {
        at_ms: row.at_ms,
        device: row.device.unwrap_or_default(),
        kind: row.kind,
        holder: row.holder,
        text,
    }
}
