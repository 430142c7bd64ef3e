//! Journal: events and commands.

use std::ops::Range;

use rusqlite::{Connection, OptionalExtension, params};
use serde::Serialize;

use super::text::printable;
use super::{DeviceId, Store, StoreError};

/// A stored event.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EventRow {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name; `None` for an event of the daemon.
    pub device: Option<String>,
    /// Kind, as a word.
    pub kind: String,
    /// Description.
    pub text: String,
}

/// A stored command with its outcome.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AuditRow {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name.
    pub device: Option<String>,
    /// Holder of the lease or user that sent it.
    pub holder: String,
    /// The command.
    pub command: String,
    /// Outcome of the command.
    pub outcome: String,
}

/// An event or a command.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct JournalRow {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name; `None` for an event of the daemon.
    pub device: Option<String>,
    /// Kind, as a word; `command` for a command.
    pub kind: String,
    /// Holder of the lease or user that sent the command; empty for an event.
    pub holder: String,
    /// Description of the event, or the command.
    pub text: String,
    /// Outcome of the command; empty for an event.
    pub outcome: String,
}

/// Filter of the journal.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JournalFilter {
    /// Only this device's, by its name; only the daemon's own if empty.
    pub device: Option<String>,
    /// Only this kind.
    pub kind: Option<String>,
    /// Only at this time or later, in milliseconds since 1970, UTC.
    pub since_ms: Option<i64>,
    /// Only before this time, in milliseconds since 1970, UTC.
    pub before_ms: Option<i64>,
    /// Most rows, 200 if `None`; beside them come all of the last one's millisecond.
    pub limit: Option<u32>,
}

/// Rows that a filter without a limit gives.
const DEFAULT_LIMIT: u32 = 200;

/// An event to be stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewEvent {
    /// Time in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name; empty for an event of the daemon.
    pub device: String,
    /// Kind, as a word.
    pub kind: &'static str,
    /// Description.
    pub text: String,
}

impl Store {
    /// Stores events in one transaction; a device that the store does not know is named in the text.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn keep_events(&mut self, events: &[NewEvent]) -> Result<(), StoreError> {
        self.change("storing events", |change| {
            let mut id_of = change.prepare("SELECT id FROM devices WHERE name = ?1")?;
            let sql = "INSERT INTO events (at_ms, device, kind, text) VALUES (?1, ?2, ?3, ?4)";
            let mut statement = change.prepare(sql)?;
            for event in events {
                let name = printable(&event.device);
                let device: Option<DeviceId> =
                    id_of.query_row([&name], |row| row.get(0)).optional()?;
                let text = match device {
                    // Before the first handshake.
                    None if !name.is_empty() => printable(&format!("{name}: {}", event.text)),
                    _ => printable(&event.text),
                };
                statement.execute(params![event.at_ms, device, event.kind, text])?;
            }
            Ok(())
        })
    }

    /// Stores an event.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn event(
        &mut self,
        device: Option<DeviceId>,
        kind: &str,
        text: &str,
    ) -> Result<(), StoreError> {
        let row = params![self.now(), device, printable(kind), printable(text)];
        let sql = "INSERT INTO events (at_ms, device, kind, text) VALUES (?1, ?2, ?3, ?4)";
        let stored = self.records().execute(sql, row).map(drop);
        stored.map_err(self.failed("storing an event"))
    }

    /// Stores an event of the store itself; a failure is only logged, because what it reports is done.
    pub(crate) fn notice(&mut self, kind: &str, text: &str) {
        if let Err(error) = self.event(None, kind, text) {
            tracing::warn!(%error, text, "a notice is not stored");
        }
    }

    /// Stores a command with its outcome and time, in milliseconds since 1970, UTC.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn audit(
        &mut self,
        at_ms: i64,
        device: Option<DeviceId>,
        holder: &str,
        command: &str,
        outcome: &str,
    ) -> Result<(), StoreError> {
        let [holder, command, outcome] = [holder, command, outcome].map(printable);
        let row = params![at_ms, device, holder, command, outcome];
        let sql = "INSERT INTO audit (at_ms, device, holder, command, outcome) VALUES (?1, ?2, ?3, ?4, ?5)";
        let stored = self.records().execute(sql, row).map(drop);
        stored.map_err(self.failed("storing a command"))
    }
}

/// Returns the last events, newest first.
pub(crate) fn events(connection: &Connection, limit: u32) -> rusqlite::Result<Vec<EventRow>> {
    let sql = "SELECT at_ms, devices.name, kind, text FROM events
        LEFT JOIN devices ON devices.id = events.device ORDER BY events.id DESC LIMIT ?1";
    let mut statement = connection.prepare(sql)?;
    let rows = statement.query_map([limit], |row| {
        Ok(EventRow {
            at_ms: row.get(0)?,
            device: row.get(1)?,
            kind: row.get(2)?,
            text: row.get(3)?,
        })
    })?;
    rows.collect()
}

/// Returns the last commands, newest first.
pub(crate) fn audit(connection: &Connection, limit: u32) -> rusqlite::Result<Vec<AuditRow>> {
    let sql = "SELECT at_ms, devices.name, holder, command, outcome FROM audit
        LEFT JOIN devices ON devices.id = audit.device ORDER BY audit.id DESC LIMIT ?1";
    let mut statement = connection.prepare(sql)?;
    let rows = statement.query_map([limit], |row| {
        Ok(AuditRow {
            at_ms: row.get(0)?,
            device: row.get(1)?,
            holder: row.get(2)?,
            command: row.get(3)?,
            outcome: row.get(4)?,
        })
    })?;
    rows.collect()
}

/// Returns the events and commands that match a filter, newest first: no part of a millisecond, so that the time of the last row, as
/// the next filter's end, leaves none out.
pub(crate) fn rows(
    connection: &Connection,
    filter: &JournalFilter,
) -> rusqlite::Result<Vec<JournalRow>> {
    let limit = filter.limit.unwrap_or(DEFAULT_LIMIT);
    let since_ms = filter.since_ms.unwrap_or(i64::MIN);
    let before_ms = filter.before_ms.unwrap_or(i64::MAX);
    let mut rows = between(connection, filter, since_ms..before_ms, limit)?;
    if rows.len() == limit as usize
        && let Some(last_ms) = rows.last().map(|row| row.at_ms)
    {
        rows.retain(|row| row.at_ms > last_ms);
        let of_last = last_ms..last_ms.saturating_add(1);
        rows.extend(between(connection, filter, of_last, u32::MAX)?);
    }
    Ok(rows)
}

/// Returns the newest rows of a time in milliseconds, at most `limit`.
fn between(
    connection: &Connection,
    filter: &JournalFilter,
    time_ms: Range<i64>,
    limit: u32,
) -> rusqlite::Result<Vec<JournalRow>> {
    // Each has an index of its own over time, so that neither is read further than the limit.
    let part = |columns: &str, table: &str, kind: &str| {
        format!(
            "SELECT * FROM (SELECT {table}.at_ms AS at_ms, {table}.id AS id, devices.name, {columns}
             FROM {table} LEFT JOIN devices ON devices.id = {table}.device
             WHERE {table}.at_ms >= ?1 AND {table}.at_ms < ?2 AND {kind}
                 AND (?4 IS NULL OR coalesce(devices.name, '') = ?4)
             ORDER BY {table}.at_ms DESC, {table}.id DESC LIMIT ?5)"
        )
    };
    let events = part(
        "kind, '' AS holder, text, '' AS outcome",
        "events",
        "(?3 IS NULL OR kind = ?3)",
    );
    let commands = part(
        "'command' AS kind, holder, command AS text, outcome",
        "audit",
        "(?3 IS NULL OR ?3 = 'command')",
    );
    let sql = format!("{events} UNION ALL {commands} ORDER BY at_ms DESC, id DESC LIMIT ?5");
    let mut statement = connection.prepare(&sql)?;
    let of = params![
        time_ms.start,
        time_ms.end,
        filter.kind,
        filter.device,
        limit
    ];
    let rows = statement.query_map(of, |row| {
        Ok(JournalRow {
            at_ms: row.get(0)?,
            device: row.get(2)?,
            kind: row.get(3)?,
            holder: row.get(4)?,
            text: row.get(5)?,
            outcome: row.get(6)?,
        })
    })?;
    rows.collect()
}
