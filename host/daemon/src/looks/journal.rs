//! What happened, as the store has it.

use ihd_store::{JournalFilter, JournalRow};

use crate::daemon::{Daemon, DaemonError};
use crate::model::JournalEntry;

/// Most entries of an answer.
const MAX_ENTRIES: u32 = 10_000;

impl Daemon {
    /// Events and commands, newest first, at most ten thousand. Who goes on with what is before the last entry's time
    /// misses no other time; entries of one millisecond are one page's.
    ///
    /// # Errors
    /// What the store reports.
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
