//! Events and commands: what happened, and who asked for what.

use rusqlite::{Connection, params};
use serde::Serialize;

use super::text::printable;
use super::{DeviceId, Store, StoreError};

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EventRow {
    /// When, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name; none where the daemon itself speaks.
    pub device: Option<String>,
    /// A word for its kind.
    pub kind: String,
    /// What.
    pub text: String,
}

/// A command, and what became of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AuditRow {
    /// When, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The device's name.
    pub device: Option<String>,
    /// Who asked.
    pub holder: String,
    /// For what.
    pub command: String,
    /// What became of it.
    pub outcome: String,
}

impl Store {
    /// Stores that something happened.
    ///
    /// # Errors
    /// What the database reports.
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

    /// Stores a command, and what became of it.
    ///
    /// # Errors
    /// What the database reports.
    pub fn audit(
        &mut self,
        device: Option<DeviceId>,
        holder: &str,
        command: &str,
        outcome: &str,
    ) -> Result<(), StoreError> {
        let [holder, command, outcome] = [holder, command, outcome].map(printable);
        let row = params![self.now(), device, holder, command, outcome];
        let sql = "INSERT INTO audit (at_ms, device, holder, command, outcome) VALUES (?1, ?2, ?3, ?4, ?5)";
        let stored = self.records().execute(sql, row).map(drop);
        stored.map_err(self.failed("storing a command"))
    }
}

/// The last events, newest first.
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

/// The last commands, newest first.
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
