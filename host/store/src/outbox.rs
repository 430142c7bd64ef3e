//! Outbox of the edge: windows, results and events that the fleet has not acknowledged yet (docs/fleet.md).

use std::hash::{BuildHasher, Hasher, RandomState};

use ihd_link::Window;
use rusqlite::{OptionalExtension, Row, params};

use super::due_window::DueWindow;
use super::fleet_state::DeliveryState;
use super::folder::{self, DayFile};
use super::results::{self, ResultRow};
use super::windows::Day;
use super::{DeviceId, EventRow, SessionId, Store, StoreError};

/// Content of a due window.
#[derive(Clone, Debug)]
pub enum OutboxItem {
    /// Not identified: the window itself.
    Window(Box<Window>),
    /// Identified here: its result.
    Result(Box<ResultRow>),
    /// Neither samples nor a result are stored any more: nothing can be sent.
    Gone,
}

const DUE: &str = "
SELECT device, boot, seq, at_ms FROM windows INDEXED BY windows_due
WHERE fleet = 0 AND (?2 IS NULL OR device IN (SELECT value FROM json_each(?2)))
ORDER BY at_ms, id LIMIT ?1";

impl Store {
    /// Returns the oldest due windows of these devices, or of all, `limit` at most.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn due(
        &mut self,
        devices: Option<&[String]>,
        limit: usize,
    ) -> Result<Vec<DueWindow>, StoreError> {
        let devices = devices.map(|names| serde_json::json!(names).to_string());
        let (mut due, mut all_done) = (Vec::new(), true);
        for file in self.days_with_due()? {
            let left = limit - due.len();
            let day = file.day.clone();
            let (of_day, is_done) = self.on_day(file, |day| {
                let of_day = day.due(devices.as_deref(), left)?;
                // Windows of other devices may become due again.
                let is_done = of_day.is_empty() && (devices.is_none() || day.count_due()? == 0);
                Ok((of_day, is_done))
            })?;
            all_done &= is_done;
            if all_done {
                self.none_due_to = Some(day);
            }
            due.extend(of_day);
            if due.len() >= limit {
                break;
            }
        }
        Ok(due)
    }

    /// Returns the number of due windows.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn count_due(&mut self) -> Result<u64, StoreError> {
        let mut count = 0;
        for file in self.days_with_due()? {
            count += self.on_day(file, Day::count_due)?;
        }
        Ok(count)
    }

    /// Returns the number of due windows of a day; 0 if there is no such day.
    ///
    /// # Errors
    /// Errors of the database.
    pub(crate) fn count_due_of(&self, day: &str) -> Result<u64, StoreError> {
        let file = self.file_of(day);
        if !file.path.exists() {
            return Ok(0);
        }
        self.on_day(file, Day::count_due)
    }

    /// Reads a due window: its result if there is one, otherwise its samples.
    ///
    /// # Errors
    /// Errors of the databases.
    pub fn read_due(&mut self, due: &DueWindow) -> Result<OutboxItem, StoreError> {
        let failed = self.failed("reading a result");
        let result = results::of_window(self.records(), &due.device, due.boot, due.seq);
        if let Some(result) = result.map_err(failed)? {
            return Ok(OutboxItem::Result(Box::new(result)));
        }
        let window = self.on_day(self.file_of(&due.day), |day| {
            day.window(&due.device, due.boot, due.seq)
        })?;
        Ok(window.map_or(OutboxItem::Gone, |window| {
            OutboxItem::Window(Box::new(window))
        }))
    }

    /// Records the outcomes of deliveries.
    ///
    /// # Errors
    /// Errors of the databases; outcomes of earlier days in the list are recorded.
    pub fn mark_sent(&mut self, sent: &[(DueWindow, DeliveryState)]) -> Result<(), StoreError> {
        for of_day in sent.chunk_by(|(a, _), (b, _)| a.day == b.day) {
            let file = self.file_of(&of_day[0].0.day);
            if file.path.exists() {
                let now_ms = self.now();
                self.on_day(file, |day| day.note(of_day, now_ms))?;
                self.tallies.remove(&of_day[0].0.day);
            }
        }
        Ok(())
    }

    /// Returns a session of this boot of a device; `None` if the store does not know the boot.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn session_of_boot(
        &self,
        device: &str,
        boot: u32,
    ) -> Result<Option<SessionId>, StoreError> {
        let sql = "SELECT sessions.id FROM sessions JOIN devices ON devices.id = sessions.device
            WHERE devices.name = ?1 AND boot = ?2 ORDER BY sessions.id DESC LIMIT 1";
        let session = self
            .records()
            .query_row(sql, params![device, boot], |row| row.get(0));
        session
            .optional()
            .map_err(self.failed("looking for a session"))
    }

    /// Returns the boot of a device's last session; `None` if there was none.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn last_boot(&self, device: DeviceId) -> Result<Option<u32>, StoreError> {
        let sql = "SELECT boot FROM sessions WHERE device = ?1 ORDER BY id DESC LIMIT 1";
        let boot = self.records().query_row(sql, [device], |row| row.get(0));
        boot.optional()
            .map_err(self.failed("looking for the last boot"))
    }

    /// Returns a window of any day; `None` if its samples are not stored.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn stored_window(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<Window>, StoreError> {
        self.on_newest_day(|day| day.window(device, boot, seq))
    }

    /// Searches the days, the newest first, until one has a result.
    pub(crate) fn on_newest_day<T>(
        &self,
        read: impl Fn(&Day) -> Result<Option<T>, StoreError>,
    ) -> Result<Option<T>, StoreError> {
        let days = folder::days(self.folder())?;
        let mut results = days.into_iter().rev().map(|file| self.on_day(file, &read));
        results.find_map(Result::transpose).transpose()
    }

    /// Returns `true` if there is a result of this window.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn has_result(&self, device: &str, boot: u32, seq: u32) -> Result<bool, StoreError> {
        let result = results::of_window(self.records(), device, boot, seq);
        let result = result.map_err(self.failed("reading a result"))?;
        Ok(result.is_some())
    }

    /// Returns events of these devices, or all, that the fleet has not acknowledged, oldest first, with their numbers, `limit` at most; and the
    /// number up to which no other is due. If none was ever sent, only those from now on.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn due_events(
        &mut self,
        devices: Option<&[String]>,
        limit: usize,
    ) -> Result<(Vec<(i64, EventRow)>, i64), StoreError> {
        let devices = devices.map(|names| serde_json::json!(names).to_string());
        self.change("looking for events", |change| {
            // Events from before the fleet are not sent.
            change.execute(
                "INSERT INTO fleet (what, value) SELECT 'events', coalesce(max(id), 0) FROM events
                 WHERE true ON CONFLICT DO NOTHING",
                [],
            )?;
            let last = "SELECT coalesce(max(id), 0) FROM events";
            let last: i64 = change.query_row(last, [], |row| row.get(0))?;
            let mut statement = change.prepare(
                "SELECT events.id, at_ms, devices.name, kind, text FROM events
                 LEFT JOIN devices ON devices.id = events.device
                 WHERE events.id > (SELECT value FROM fleet WHERE what = 'events')
                     AND (?2 IS NULL OR devices.name IN (SELECT value FROM json_each(?2)))
                     AND events.id > coalesce(
                         (SELECT value FROM fleet WHERE what = 'events ' || devices.name), 0)
                 ORDER BY events.id LIMIT ?1",
            )?;
            let row = |row: &Row<'_>| {
                let event = EventRow {
                    at_ms: row.get(1)?,
                    device: row.get(2)?,
                    kind: row.get(3)?,
                    text: row.get(4)?,
                };
                Ok((row.get(0)?, event))
            };
            let rows = statement.query_map(params![limit as i64, devices], row)?;
            let due: Vec<(i64, EventRow)> = rows.collect::<rusqlite::Result<_>>()?;
            let up_to = match due.last() {
                Some((number, _)) if due.len() >= limit => *number,
                _ => last,
            };
            Ok((due, up_to))
        })
    }

    /// Marks the events of each device up to a number as acknowledged by the fleet, or, with `all`, those of every device.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn mark_events_sent(
        &mut self,
        sent: &[(String, i64)],
        all: Option<i64>,
    ) -> Result<(), StoreError> {
        self.change("noting what was sent", |change| {
            for (device, up_to) in sent {
                change.execute(
                    "INSERT INTO fleet (what, value) VALUES ('events ' || ?1, ?2)
                     ON CONFLICT (what) DO UPDATE SET value = max(value, ?2)",
                    params![device, up_to],
                )?;
            }
            if let Some(all) = all {
                let mark = "UPDATE fleet SET value = max(value, ?1) WHERE what = 'events'";
                change.execute(mark, [all])?;
                let covered = "DELETE FROM fleet WHERE what GLOB 'events *' AND value <= ?1";
                change.execute(covered, [all])?;
            }
            Ok(())
        })
    }

    /// Returns the store's secret, by which the fleet recognises its messages. It is created once.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn fleet_secret(&mut self) -> Result<[u8; 16], StoreError> {
        // Keys from the operating system's random source.
        let chance = || RandomState::new().build_hasher().finish().cast_signed();
        let mut secret = [0; 16];
        for (half, what) in secret.chunks_mut(8).zip(["secret 1", "secret 2"]) {
            let made = chance();
            let stored: i64 = self.change("making a secret", |change| {
                change.execute(
                    "INSERT INTO fleet (what, value) VALUES (?1, ?2) ON CONFLICT DO NOTHING",
                    params![what, made],
                )?;
                change.query_row("SELECT value FROM fleet WHERE what = ?1", [what], |row| {
                    row.get(0)
                })
            })?;
            half.copy_from_slice(&stored.to_be_bytes());
        }
        Ok(secret)
    }

    fn days_with_due(&self) -> Result<Vec<DayFile>, StoreError> {
        let mut days = folder::days(self.folder())?;
        if let Some(none_to) = &self.none_due_to {
            days.retain(|file| file.day > *none_to);
        }
        Ok(days)
    }

    pub(crate) fn file_of(&self, day: &str) -> DayFile {
        DayFile {
            day: day.to_owned(),
            path: folder::of_day(self.folder(), day),
        }
    }

    /// Calls a function with a day's database, which is opened if it is not open.
    pub(crate) fn on_day<T>(
        &self,
        file: DayFile,
        what: impl FnOnce(&Day) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        match self.days.each().find(|day| day.file == file) {
            Some(day) => what(day),
            None => what(&Day::open(file)?),
        }
    }
}

impl Day {
    fn due(&self, devices: Option<&str>, limit: usize) -> Result<Vec<DueWindow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<DueWindow>> {
            let mut statement = self.connection.prepare(DUE)?;
            let row = |row: &Row<'_>| self.due_window(row);
            statement
                .query_map(params![limit as i64, devices], row)?
                .collect()
        };
        read().map_err(StoreError::database(self.path(), "looking for what is due"))
    }

    /// Returns the number of due windows of this day.
    pub(crate) fn count_due(&self) -> Result<u64, StoreError> {
        let sql = "SELECT count(*) FROM windows WHERE fleet = 0";
        let count = self
            .connection
            .query_row(sql, [], |row| row.get::<_, i64>(0));
        let count = count.map_err(StoreError::database(self.path(), "counting what is due"))?;
        Ok(u64::try_from(count).unwrap_or(0))
    }
}
