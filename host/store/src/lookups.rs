//! Lookups and their states: pending before a push, active when the device reports so, then superseded; or refused.

use std::fmt;

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CELLS, CURRENTS, FREQUENCIES};
use rusqlite::types::{FromSql, FromSqlError, FromSqlResult, ValueRef};
use rusqlite::{Connection, OptionalExtension, Row, ToSql, Transaction, params};
use serde::Serialize;

use super::text::printable;
use super::{DeviceId, Store, StoreError};

/// State of a lookup on its device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LookupState {
    /// Pushed or about to be, without the device's reply.
    Pending,
    /// The device uses it.
    Active,
    /// Replaced by another one.
    Superseded,
    /// Refused by the device.
    Refused,
}

impl fmt::Display for LookupState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pending => "pending",
            Self::Active => "active",
            Self::Superseded => "superseded",
            Self::Refused => "refused",
        })
    }
}

impl FromSql for LookupState {
    fn column_result(value: ValueRef<'_>) -> FromSqlResult<Self> {
        match value.as_str()? {
            "pending" => Ok(Self::Pending),
            "active" => Ok(Self::Active),
            "superseded" => Ok(Self::Superseded),
            "refused" => Ok(Self::Refused),
            _ => Err(FromSqlError::InvalidType),
        }
    }
}

/// A lookup in the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LookupRow {
    /// The device's name.
    pub device: String,
    /// Its version.
    pub version: u32,
    /// State on the device.
    pub state: LookupState,
    /// Origin: `host`, or `device` if it was found there.
    pub origin: String,
    /// Time of the last change of state, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Reason for which it was built or refused.
    pub why: String,
    /// Its bytes ([`RlLookup::from_bytes`]).
    #[serde(skip)]
    pub blob: Vec<u8>,
}

/// Returns the lookups that were active before the present one, of version `on_device`, newest first; `rows` are oldest first.
pub fn superseded_lookups(rows: &[LookupRow], on_device: u32) -> impl Iterator<Item = &LookupRow> {
    let was_active =
        move |row: &&LookupRow| row.state == LookupState::Superseded && row.version != on_device;
    rows.iter().rev().filter(was_active)
}

/// A number of each cell of a lookup, `[frequency][current]`.
type CellTable = [[f64; CURRENTS]; FREQUENCIES];

/// Confidence of each cell of a lookup, 0 to 1 in 255 steps, and standard deviations of R and L in steps of 0.01 %.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certainty {
    confidence: Vec<u8>,
    sigma: Option<Vec<u8>>,
}

impl Certainty {
    /// Quantises a table of 0 to 1, and relative deviations of R and L.
    pub fn quantise(confidence: &CellTable, sigma: &[CellTable; 2]) -> Self {
        let byte = |x: &f64| (x.clamp(0.0, 1.0) * 255.0).round() as u8;
        // A deviation that is no number is a large one.
        let code = |x: &f64| match x.is_nan() {
            true => u16::MAX,
            false => (x * 100.0 * SIGMA_STEPS).round() as u16,
        };
        let codes = sigma.iter().flatten().flatten().map(code);
        Self {
            confidence: confidence.iter().flatten().map(byte).collect(),
            sigma: Some(codes.flat_map(u16::to_le_bytes).collect()),
        }
    }

    /// Returns the confidence, 0 to 1.
    pub fn confidence(&self) -> Vec<Vec<f64>> {
        let rows = self.confidence.chunks(CURRENTS);
        let cell = |byte: &u8| f64::from(*byte) / 255.0;
        rows.map(|row| row.iter().map(cell).collect()).collect()
    }

    /// Returns the standard deviations of R and L in percent of them; `None` in a lookup that an earlier version built.
    pub fn sigma_pct(&self) -> Option<[Vec<Vec<f64>>; 2]> {
        let (r, l) = self.sigma.as_ref()?.split_at(2 * CELLS);
        let cell = |code: &[u8; 2]| f64::from(u16::from_le_bytes(*code)) / SIGMA_STEPS;
        let row = |row: &[[u8; 2]]| row.iter().map(cell).collect();
        Some([r, l].map(|of| of.as_chunks().0.chunks(CURRENTS).map(row).collect()))
    }
}

/// Steps of a percent in which deviations are stored.
const SIGMA_STEPS: f64 = 100.0;

/// Returns how well the cells of the latest lookup of a version are known; `None` if it was not stored. `sigma` is `false` in a database that has
/// no such column yet.
pub(crate) fn certainty(
    connection: &Connection,
    device: &str,
    version: u32,
    sigma: bool,
) -> rusqlite::Result<Option<Certainty>> {
    let sigma = if sigma { "sigma" } else { "NULL" };
    let sql = format!(
        "SELECT confidence, {sigma} FROM lookups WHERE version = ?2
         AND device = (SELECT id FROM devices WHERE name = ?1)
         ORDER BY state = 'pending' DESC, id DESC LIMIT 1"
    );
    let whole = |bytes: Option<Vec<u8>>, length| bytes.filter(|bytes| bytes.len() == length);
    let read = |row: &Row<'_>| {
        let sigma = whole(row.get(1)?, 4 * CELLS);
        Ok(whole(row.get(0)?, CELLS).map(|confidence| Certainty { confidence, sigma }))
    };
    let found = connection.query_row(&sql, params![device, version], read);
    found.optional().map(Option::flatten)
}

/// Superseded and refused lookups of a device that are kept: the newest.
const KEPT_PAST: i64 = 300;

/// Most lookups of a device that are listed: those that are kept, the active one and the pending one.
const MAX_LISTED: i64 = KEPT_PAST + 2;

/// Deletes all past lookups of each device but the newest.
pub(crate) const DROP_PAST: (&str, i64) = (
    "DELETE FROM lookups WHERE id IN (
       SELECT id FROM (
         SELECT id, row_number() OVER (PARTITION BY device ORDER BY id DESC) AS place
         FROM lookups WHERE state IN ('superseded', 'refused')
       ) WHERE place > ?1)",
    KEPT_PAST,
);

const COLUMNS: &str = "
SELECT devices.name, version, state, origin, at_ms, why, blob
FROM lookups JOIN devices ON devices.id = lookups.device";

fn lookup_row(row: &Row<'_>) -> rusqlite::Result<LookupRow> {
    Ok(LookupRow {
        device: row.get(0)?,
        version: row.get(1)?,
        state: row.get(2)?,
        origin: row.get(3)?,
        at_ms: row.get(4)?,
        why: row.get(5)?,
        blob: row.get(6)?,
    })
}

/// Returns every lookup of all devices, oldest first.
pub(crate) fn rows(connection: &Connection) -> rusqlite::Result<Vec<LookupRow>> {
    let sql = format!("{COLUMNS} ORDER BY lookups.device, lookups.id");
    let mut statement = connection.prepare(&sql)?;
    let rows = statement.query_map([], lookup_row)?;
    rows.collect()
}

/// Returns the lookups of the device with a value in a column of `devices`, oldest first: the active one, the pending one and the newest
/// others.
pub(crate) fn of_device(
    connection: &Connection,
    column: &str,
    value: impl ToSql,
) -> rusqlite::Result<Vec<LookupRow>> {
    let sql = format!(
        "{COLUMNS} WHERE lookups.id IN (
           SELECT id FROM lookups WHERE device = (SELECT id FROM devices WHERE {column} = ?1)
           ORDER BY state IN ('active', 'pending') DESC, id DESC LIMIT ?2)
         ORDER BY lookups.id"
    );
    let mut statement = connection.prepare(&sql)?;
    let rows = statement.query_map(params![value, MAX_LISTED], lookup_row)?;
    rows.collect()
}

/// Returns the lookup of a version that is pending, or the newest one: after a reset of the device, versions count from 0 again. `None` for the
/// version asks for the active lookup.
pub(crate) fn one(
    connection: &Connection,
    device: &str,
    version: Option<u32>,
) -> rusqlite::Result<Option<LookupRow>> {
    let sql = format!(
        "{COLUMNS} WHERE devices.name = ?1 AND CASE WHEN ?2 IS NULL THEN state = 'active' ELSE version = ?2 END
         ORDER BY state = 'pending' DESC, lookups.id DESC LIMIT 1"
    );
    connection
        .query_row(&sql, params![device, version], lookup_row)
        .optional()
}

impl Store {
    /// Stores a lookup that is about to be pushed, with how well its cells are known, where it was learned. Another pending one is superseded; the same
    /// one, pushed again, is not stored twice.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn pend_lookup(
        &mut self,
        device: DeviceId,
        lookup: &RlLookup,
        why: &str,
        certainty: Option<&Certainty>,
    ) -> Result<(), StoreError> {
        let (at_ms, blob, why) = (self.now(), lookup.to_bytes(), printable(why));
        self.change("storing a lookup", |change| {
            change.execute(
                "UPDATE lookups SET state = 'superseded', at_ms = ?2
                 WHERE device = ?1 AND state = 'pending' AND blob <> ?3",
                params![device, at_ms, blob],
            )?;
            let same = change.execute(
                "UPDATE lookups SET at_ms = ?2, why = ?4
                 WHERE device = ?1 AND state = 'pending' AND blob = ?3",
                params![device, at_ms, blob, why],
            )?;
            if same == 0 {
                insert(change, device, lookup, ("pending", "host"), at_ms, &why)?;
            }
            if let Some(Certainty { confidence, sigma }) = certainty {
                change.execute(
                    "UPDATE lookups SET confidence = ?2, sigma = ?3
                     WHERE device = ?1 AND state = 'pending'",
                    params![device, confidence, sigma],
                )?;
            }
            Ok(())
        })
    }

    /// Marks the lookup of this version as refused by the device.
    ///
    /// # Errors
    /// [`StoreError::NoLookup`]; [`StoreError::LookupState`] if it is active or superseded;
    /// or an error of the database.
    pub fn refuse_lookup(
        &mut self,
        device: DeviceId,
        version: u32,
        why: &str,
    ) -> Result<(), StoreError> {
        let (at_ms, why) = (self.now(), printable(why));
        let lookup = self.change("refusing a lookup", |change| {
            let lookup = newest(change, device, version)?;
            if let Some((id, LookupState::Pending)) = lookup {
                change.execute(
                    "UPDATE lookups SET state = 'refused', at_ms = ?2, why = ?3 WHERE id = ?1",
                    params![id, at_ms, why],
                )?;
            }
            Ok(lookup)
        })?;
        match lookup {
            None => Err(StoreError::NoLookup { version }),
            Some((_, LookupState::Pending | LookupState::Refused)) => Ok(()),
            Some((_, state)) => Err(StoreError::LookupState { version, state }),
        }
    }

    /// Marks a lookup that was read from the device as active, and the one before as superseded. If the store has it, bit for
    /// bit, it is that one, even if superseded or refused; otherwise it is stored as a new one of the device's. Idempotent.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn adopt_lookup(&mut self, device: DeviceId, lookup: &RlLookup) -> Result<(), StoreError> {
        let at_ms = self.now();
        self.change("adopting a lookup", |change| {
            adopt(change, device, lookup, at_ms)
        })
    }

    /// Deletes the stored state of a device's learner, and makes `lookup` the active one as [`Store::adopt_lookup`]; results stay. Changes
    /// nothing if `may_begin`, which is called once the database is locked for the change, returns `false`. Returns what it returned.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn reset_learning(
        &mut self,
        device: DeviceId,
        lookup: &RlLookup,
        may_begin: impl FnOnce() -> bool,
    ) -> Result<bool, StoreError> {
        let at_ms = self.now();
        self.change("forgetting what was learned", |change| {
            if !may_begin() {
                return Ok(false);
            }
            change.execute("DELETE FROM learned WHERE device = ?1", [device])?;
            adopt(change, device, lookup, at_ms)?;
            Ok(true)
        })
    }

    /// Returns how well the cells of a device's lookup of this version are known; `None` if it was not stored.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn certainty(&self, device: &str, version: u32) -> Result<Option<Certainty>, StoreError> {
        certainty(self.records(), device, version, true)
            .map_err(self.failed("reading how well a lookup is known"))
    }

    /// Returns the newest lookup of a device of a version, the pending one first; for `None` the active one.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn lookup(
        &self,
        device: &str,
        version: Option<u32>,
    ) -> Result<Option<LookupRow>, StoreError> {
        one(self.records(), device, version).map_err(self.failed("reading a lookup"))
    }

    /// Returns the lookups of a device, oldest first: the active one, the pending one and the newest others.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn lookups(&self, device: DeviceId) -> Result<Vec<LookupRow>, StoreError> {
        of_device(self.records(), "id", device).map_err(self.failed("listing lookups"))
    }
}

fn adopt(
    change: &Transaction<'_>,
    device: DeviceId,
    lookup: &RlLookup,
    at_ms: i64,
) -> rusqlite::Result<()> {
    let known = change
        .query_row(
            "SELECT id FROM lookups WHERE device = ?1 AND version = ?2 AND blob = ?3
             ORDER BY id DESC LIMIT 1",
            params![device, lookup.version, lookup.to_bytes()],
            |row| row.get(0),
        )
        .optional()?;
    let id = match known {
        Some(id) => id,
        // Superseded until the next statement: the schema allows one active lookup.
        None => {
            let as_what = ("superseded", "device");
            insert(
                change,
                device,
                lookup,
                as_what,
                at_ms,
                "found on the device",
            )?
        }
    };
    make_active(change, device, id, at_ms)
}

fn insert(
    change: &Transaction<'_>,
    device: DeviceId,
    lookup: &RlLookup,
    (state, origin): (&str, &str),
    at_ms: i64,
    why: &str,
) -> rusqlite::Result<i64> {
    change.execute(
        "INSERT INTO lookups (device, version, state, origin, at_ms, why, blob)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![
            device,
            lookup.version,
            state,
            origin,
            at_ms,
            why,
            lookup.to_bytes()
        ],
    )?;
    Ok(change.last_insert_rowid())
}

/// Returns the latest lookup of a version: after a reset of the device's lookup, version numbers are used again.
fn newest(
    change: &Transaction<'_>,
    device: DeviceId,
    version: u32,
) -> rusqlite::Result<Option<(i64, LookupState)>> {
    change
        .query_row(
            "SELECT id, state FROM lookups WHERE device = ?1 AND version = ?2
             ORDER BY state = 'pending' DESC, id DESC LIMIT 1",
            params![device, version],
            |row| Ok((row.get(0)?, row.get(1)?)),
        )
        .optional()
}

fn make_active(
    change: &Transaction<'_>,
    device: DeviceId,
    id: i64,
    at_ms: i64,
) -> rusqlite::Result<()> {
    change.execute(
        "UPDATE lookups SET state = 'superseded', at_ms = ?3
         WHERE device = ?1 AND state = 'active' AND id <> ?2",
        params![device, id, at_ms],
    )?;
    change.execute(
        "UPDATE lookups SET state = 'active', at_ms = ?2 WHERE id = ?1 AND state <> 'active'",
        params![id, at_ms],
    )?;
    Ok(())
}
