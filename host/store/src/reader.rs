//! Read access to a store, beside its writer.

use std::path::{Path, PathBuf};

use ihd_link::Window;
use rusqlite::{Connection, OptionalExtension, Row};
use serde::Serialize;

use super::curves::Curves;
use super::folder::{self, RECORDS};
use super::windows::{Day, WindowFilter, WindowRow};
use super::{
    AuditRow, Certainty, EventRow, JournalFilter, JournalRow, LastAccepted, LookupRow,
    ResultFilter, ResultId, ResultRow, SessionId, StoreError, database, journal, lookups, results,
    schema,
};

/// A store opened for reading. It blocks no writer and takes no lock.
pub struct StoreReader {
    folder: PathBuf,
    path: PathBuf,
    records: Connection,
}

/// A device in the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceRow {
    /// Its name in the configuration.
    pub name: String,
    /// Last address.
    pub address: String,
    /// Time of the first connection, in milliseconds since 1970, UTC.
    pub first_seen_ms: i64,
}

/// A connection in the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SessionRow {
    /// Its number.
    pub id: SessionId,
    /// The device's name.
    pub device: String,
    /// The device's boot.
    pub boot: u32,
    /// Time of its beginning, in milliseconds since 1970, UTC.
    pub began_ms: i64,
    /// Time of its end, in milliseconds since 1970, UTC; `None` while it lasts.
    pub ended_ms: Option<i64>,
    /// Reason of its end.
    pub why: Option<String>,
    /// The firmware's build.
    pub build: String,
    /// The board.
    pub board: String,
    /// Bits of `ihd_shared::wire::hello`'s `CAP_` constants.
    pub capabilities: u32,
    /// Half the range of the voltage channel, in millivolt.
    pub v_full_scale_mv: u32,
    /// Half the range of the current channel, in milliampere.
    pub i_full_scale_ma: u32,
    /// Bits of a code.
    pub bits: u8,
}

const SESSIONS: &str = "
SELECT sessions.id, devices.name, boot, began_ms, ended_ms, why, build, board, capabilities,
    v_full_scale_mv, i_full_scale_ma, bits
FROM sessions JOIN devices ON devices.id = sessions.device";

impl StoreReader {
    /// Opens the store in a folder for reading.
    ///
    /// # Errors
    /// [`StoreError::NoStore`], [`StoreError::Damaged`], [`StoreError::Newer`], or an error of the database.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(RECORDS);
        if !path.exists() {
            let folder = folder.to_owned();
            return Err(StoreError::NoStore { folder });
        }
        let records = database::open_to_read(&path, &schema::RECORDS)?;
        Ok(Self {
            folder: folder.to_owned(),
            path,
            records,
        })
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn records(&self) -> &Connection {
        &self.records
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    fn failed(&self, doing: &'static str) -> impl FnOnce(rusqlite::Error) -> StoreError + use<> {
        StoreError::database(&self.path, doing)
    }

    pub(crate) fn count(&self, sql: &str) -> Result<u64, StoreError> {
        let count = self.records.query_row(sql, [], |row| row.get::<_, i64>(0));
        let count = count.map_err(self.failed("counting"))?;
        Ok(u64::try_from(count).unwrap_or(0))
    }

    /// Returns results, newest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn results(&self, filter: &ResultFilter) -> Result<Vec<ResultRow>, StoreError> {
        results::rows(&self.records, filter).map_err(self.failed("listing results"))
    }

    /// Returns one result; `None` if there is none of this number.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn result(&self, id: ResultId) -> Result<Option<ResultRow>, StoreError> {
        results::one(&self.records, id).map_err(self.failed("reading a result"))
    }

    /// Returns every lookup of every device, oldest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn lookups(&self) -> Result<Vec<LookupRow>, StoreError> {
        lookups::rows(&self.records).map_err(self.failed("listing lookups"))
    }

    /// Returns the lookups of a device, oldest first, as [`Store::lookups`](super::Store::lookups) does.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn lookups_of(&self, device: &str) -> Result<Vec<LookupRow>, StoreError> {
        lookups::of_device(&self.records, "name", device).map_err(self.failed("listing lookups"))
    }

    /// Returns the newest lookup of a device of a version, as [`Store::lookup`](super::Store::lookup) does.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn lookup(
        &self,
        device: &str,
        version: Option<u32>,
    ) -> Result<Option<LookupRow>, StoreError> {
        lookups::one(&self.records, device, version).map_err(self.failed("reading a lookup"))
    }

    /// Returns every device.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn devices(&self) -> Result<Vec<DeviceRow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<DeviceRow>> {
            let sql = "SELECT name, address, first_seen_ms FROM devices ORDER BY name";
            let mut statement = self.records.prepare(sql)?;
            let rows = statement.query_map([], |row| {
                Ok(DeviceRow {
                    name: row.get(0)?,
                    address: row.get(1)?,
                    first_seen_ms: row.get(2)?,
                })
            })?;
            rows.collect()
        };
        read().map_err(self.failed("listing devices"))
    }

    /// Returns one session; `None` if there is none of this number.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn session(&self, id: SessionId) -> Result<Option<SessionRow>, StoreError> {
        let sql = format!("{SESSIONS} WHERE sessions.id = ?1");
        let row = self.records.query_row(&sql, [id], session_row).optional();
        row.map_err(self.failed("reading a session"))
    }

    /// Returns the last session of a device's boot; `None` if there is none.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn session_of(&self, device: &str, boot: u32) -> Result<Option<SessionRow>, StoreError> {
        let sql = format!(
            "{SESSIONS} WHERE devices.name = ?1 AND boot = ?2 ORDER BY sessions.id DESC LIMIT 1"
        );
        let of = rusqlite::params![device, boot];
        let row = self.records.query_row(&sql, of, session_row).optional();
        row.map_err(self.failed("reading a session"))
    }

    /// Returns how well the cells of a device's lookup of this version are known; `None` if it was not stored.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn certainty(&self, device: &str, version: u32) -> Result<Option<Certainty>, StoreError> {
        // A store of an earlier version that was not opened for writing since lacks one of the columns, or both.
        let sql = "SELECT count(*) FROM pragma_table_info('lookups') WHERE name IN ('confidence', 'sigma')";
        let failed = || self.failed("reading how well a lookup is known");
        let there: u8 = self
            .records
            .query_row(sql, [], |row| row.get(0))
            .map_err(failed())?;
        match there {
            0 => Ok(None),
            columns => {
                lookups::certainty(&self.records, device, version, columns == 2).map_err(failed())
            }
        }
    }

    /// Returns the events and commands that match a filter, newest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn journal(&self, filter: &JournalFilter) -> Result<Vec<JournalRow>, StoreError> {
        journal::rows(&self.records, filter).map_err(self.failed("reading the journal"))
    }

    /// Returns results of a device in a stretch of time, oldest first, and their number. If they are more than
    /// `limit`, the first one of each of `limit` equal parts of the time is returned.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn results_between(
        &self,
        device: &str,
        (from_ms, to_ms): (i64, i64),
        limit: usize,
    ) -> Result<(u64, Vec<ResultRow>), StoreError> {
        results::between(&self.records, device, (from_ms, to_ms), limit)
            .map_err(self.failed("listing results"))
    }

    /// Returns the result of a window; `None` if there is none.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn result_of(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<ResultRow>, StoreError> {
        results::of_window(&self.records, device, boot, seq)
            .map_err(self.failed("reading a result"))
    }

    /// Returns the last accepted result at each frequency and current, of those after `after`.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn last_accepted(
        &self,
        device: &str,
        after: ResultId,
    ) -> Result<Vec<LastAccepted>, StoreError> {
        results::last_accepted(&self.records, device, after).map_err(self.failed("reading results"))
    }

    /// Returns the last events, newest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn events(&self, limit: u32) -> Result<Vec<EventRow>, StoreError> {
        journal::events(&self.records, limit).map_err(self.failed("listing events"))
    }

    /// Returns the last commands, newest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn audit(&self, limit: u32) -> Result<Vec<AuditRow>, StoreError> {
        journal::audit(&self.records, limit).map_err(self.failed("listing commands"))
    }

    /// Returns the rows of the windows that match a filter, oldest day first.
    ///
    /// # Errors
    /// Errors of the databases.
    pub fn windows(&self, filter: &WindowFilter) -> Result<Vec<WindowRow>, StoreError> {
        let mut rows = Vec::new();
        for day in self.days_since(filter.since_ms)? {
            rows.extend(day.rows(filter)?);
        }
        Ok(rows)
    }

    /// Returns the last windows of a device, newest first, `limit` at most; only those with samples if `whole`.
    ///
    /// # Errors
    /// Errors of the databases.
    pub fn last_windows(
        &self,
        device: &str,
        limit: usize,
        whole: bool,
    ) -> Result<Vec<WindowRow>, StoreError> {
        let mut rows = Vec::new();
        for file in folder::days(&self.folder)?.into_iter().rev() {
            let left = limit.saturating_sub(rows.len());
            if left == 0 {
                break;
            }
            if let Some(day) = Day::open_to_read(file)? {
                rows.extend(day.last_rows(device, left, whole)?);
            }
        }
        Ok(rows)
    }

    /// Returns the row of a window with its samples and curves; `None` if there is none, or its samples are not stored.
    ///
    /// # Errors
    /// [`StoreError::Window`] if it cannot be unpacked, or an error of the databases.
    pub fn whole_window(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<(WindowRow, Window, Curves)>, StoreError> {
        for file in folder::days(&self.folder)?.into_iter().rev() {
            let Some(day) = Day::open_to_read(file)? else {
                continue;
            };
            let Some(window) = day.window(device, boot, seq)? else {
                continue;
            };
            if let Some(row) = day.row(device, boot, seq)? {
                return Ok(Some((row, window, day.curves(device, boot, seq)?)));
            }
        }
        Ok(None)
    }

    /// Returns a window with its samples; `None` if there is none, or its samples are not stored.
    ///
    /// # Errors
    /// [`StoreError::Window`] if it cannot be unpacked, or an error of the databases.
    pub fn window(&self, device: &str, boot: u32, seq: u32) -> Result<Option<Window>, StoreError> {
        for day in self.days_since(None)?.into_iter().rev() {
            if let Some(window) = day.window(device, boot, seq)? {
                return Ok(Some(window));
            }
        }
        Ok(None)
    }

    /// Opens the days of a stretch of time, oldest first.
    pub(crate) fn days_between(&self, from_ms: i64, to_ms: i64) -> Result<Vec<Day>, StoreError> {
        let [first, last] = [from_ms, to_ms].map(|at_ms| super::clock::day(at_ms.max(0)));
        let days = folder::days(&self.folder)?.into_iter();
        let selected = days.filter(|file| file.day >= first && file.day <= last);
        selected
            .filter_map(|file| Day::open_to_read(file).transpose())
            .collect()
    }

    /// Opens the days with windows of that time or later, oldest first.
    pub(crate) fn days_since(&self, since_ms: Option<i64>) -> Result<Vec<Day>, StoreError> {
        let first = since_ms.map(super::clock::day);
        let days = folder::days(&self.folder)?;
        let selected = days
            .into_iter()
            .filter(|file| first.as_ref().is_none_or(|first| file.day >= *first));
        selected
            .filter_map(|file| Day::open_to_read(file).transpose())
            .collect()
    }
}

fn session_row(row: &Row<'_>) -> rusqlite::Result<SessionRow> {
    Ok(SessionRow {
        id: row.get(0)?,
        device: row.get(1)?,
        boot: row.get(2)?,
        began_ms: row.get(3)?,
        ended_ms: row.get(4)?,
        why: row.get(5)?,
        build: row.get(6)?,
        board: row.get(7)?,
        capabilities: row.get(8)?,
        v_full_scale_mv: row.get(9)?,
        i_full_scale_ma: row.get(10)?,
        bits: row.get(11)?,
    })
}
