//! What a fleet has not acknowledged yet: the store is the edge's outbox (docs/fleet.md).

use std::hash::{BuildHasher, Hasher, RandomState};

use ihd_link::Window;
use rusqlite::{OptionalExtension, Row, params};

use super::fleet_state::Sent;
use super::folder::{self, DayFile};
use super::results::{self, ResultRow};
use super::windows::Day;
use super::{EventRow, SessionId, Store, StoreError};

/// A window that a fleet has not acknowledged, nor its result.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DueWindow {
    /// The day of its file, `YYYY-MM-DD`.
    pub day: String,
    /// The device's name.
    pub device: String,
    /// The device's boot.
    pub boot: u32,
    /// Its number since the boot.
    pub seq: u32,
    /// When it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
}

/// What there is of a window that is due.
#[derive(Clone, Debug)]
pub enum Due {
    /// Nobody has identified it.
    Window(Box<Window>),
    /// It was identified here.
    Result(Box<ResultRow>),
    /// Neither its samples nor a result are here any more: nothing can be sent.
    Gone,
}

const DUE: &str = "
SELECT device, boot, seq, at_ms FROM windows INDEXED BY windows_due
WHERE fleet = 0 ORDER BY at_ms, id LIMIT ?1";

impl Store {
    /// The oldest windows that are due, at most so many.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn due(&mut self, limit: usize) -> Result<Vec<DueWindow>, StoreError> {
        let mut due = Vec::new();
        for file in self.days_with_due()? {
            let left = limit - due.len();
            let day = file.day.clone();
            let found = self.on_day(file, |day| day.due(left))?;
            if found.is_empty() && due.is_empty() {
                self.none_due_to = Some(day);
            }
            due.extend(found);
            if due.len() >= limit {
                break;
            }
        }
        Ok(due)
    }

    /// How many windows are due.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn count_due(&mut self) -> Result<u64, StoreError> {
        let mut count = 0;
        for file in self.days_with_due()? {
            count += self.on_day(file, Day::count_due)?;
        }
        Ok(count)
    }

    /// How many windows of a day are due; none where there is no such day.
    ///
    /// # Errors
    /// What the database reports.
    pub(crate) fn count_due_of(&self, day: &str) -> Result<u64, StoreError> {
        let file = self.file_of(day);
        if !file.path.exists() {
            return Ok(0);
        }
        self.on_day(file, Day::count_due)
    }

    /// What there is of a window that is due: its result before its samples.
    ///
    /// # Errors
    /// What the databases report.
    pub fn read_due(&mut self, due: &DueWindow) -> Result<Due, StoreError> {
        let failed = self.failed("reading a result");
        let result = results::of_window(self.records(), &due.device, due.boot, due.seq);
        if let Some(result) = result.map_err(failed)? {
            return Ok(Due::Result(Box::new(result)));
        }
        let window = self.on_day(self.file_of(&due.day), |day| {
            day.window(&due.device, due.boot, due.seq)
        })?;
        Ok(window.map_or(Due::Gone, |window| Due::Window(Box::new(window))))
    }

    /// Outcomes of windows that were due.
    ///
    /// # Errors
    /// What the databases report; those of days before have been noted.
    pub fn sent(&mut self, sent: &[(DueWindow, Sent)]) -> Result<(), StoreError> {
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

    /// The connection that a window of this boot of a device came over; none where the store does not know it.
    ///
    /// # Errors
    /// What the database reports.
    pub fn session_of_boot(
        &self,
        device: &str,
        boot: u32,
    ) -> Result<Option<SessionId>, StoreError> {
        let sql = "SELECT sessions.id FROM sessions JOIN devices ON devices.id = sessions.device
            WHERE devices.name = ?1 AND boot = ?2 ORDER BY sessions.id DESC LIMIT 1";
        let found = self
            .records()
            .query_row(sql, params![device, boot], |row| row.get(0));
        found
            .optional()
            .map_err(self.failed("looking for a session"))
    }

    /// A window of whatever day; none where its samples are not kept.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn stored_window(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<Window>, StoreError> {
        let mut days = folder::days(self.folder())?;
        days.reverse();
        for file in days {
            let window = self.on_day(file, |day| day.window(device, boot, seq))?;
            if window.is_some() {
                return Ok(window);
            }
        }
        Ok(None)
    }

    /// Whether there is a result of this window.
    ///
    /// # Errors
    /// What the database reports.
    pub fn has_result(&self, device: &str, boot: u32, seq: u32) -> Result<bool, StoreError> {
        let found = results::of_window(self.records(), device, boot, seq);
        let found = found.map_err(self.failed("reading a result"))?;
        Ok(found.is_some())
    }

    /// Events that the fleet has not acknowledged, oldest first, with their numbers. Where nothing was ever sent, those from now on.
    ///
    /// # Errors
    /// What the database reports.
    pub fn due_events(&mut self, limit: usize) -> Result<Vec<(i64, EventRow)>, StoreError> {
        self.change("looking for events", |change| {
            // A fleet is told no history.
            change.execute(
                "INSERT INTO fleet (what, value) SELECT 'events', coalesce(max(id), 0) FROM events
                 WHERE true ON CONFLICT DO NOTHING",
                [],
            )?;
            let mut statement = change.prepare(
                "SELECT events.id, at_ms, devices.name, kind, text FROM events
                 LEFT JOIN devices ON devices.id = events.device
                 WHERE events.id > (SELECT value FROM fleet WHERE what = 'events')
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
            let rows = statement.query_map([limit as i64], row)?;
            rows.collect()
        })
    }

    /// The fleet has acknowledged all events up to this number.
    ///
    /// # Errors
    /// What the database reports.
    pub fn events_sent(&mut self, up_to: i64) -> Result<(), StoreError> {
        self.change("noting what was sent", |change| {
            change.execute("UPDATE fleet SET value = ?1 WHERE what = 'events'", [up_to])?;
            Ok(())
        })
    }

    /// What only this store knows: by it a fleet knows what it sends. It is made once.
    ///
    /// # Errors
    /// What the database reports.
    pub fn fleet_secret(&mut self) -> Result<[u8; 16], StoreError> {
        // Keys from the operating system's source of chance.
        let chance = || RandomState::new().build_hasher().finish().cast_signed();
        let mut secret = [0; 16];
        for (half, what) in secret.chunks_mut(8).zip(["secret 1", "secret 2"]) {
            let made = chance();
            let kept: i64 = self.change("making a secret", |change| {
                change.execute(
                    "INSERT INTO fleet (what, value) VALUES (?1, ?2) ON CONFLICT DO NOTHING",
                    params![what, made],
                )?;
                change.query_row("SELECT value FROM fleet WHERE what = ?1", [what], |row| {
                    row.get(0)
                })
            })?;
            half.copy_from_slice(&kept.to_be_bytes());
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

    /// Does something with a day, open or not.
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
    fn due(&self, limit: usize) -> Result<Vec<DueWindow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<DueWindow>> {
            let mut statement = self.connection.prepare(DUE)?;
            let row = |row: &Row<'_>| self.due_window(row);
            statement.query_map([limit as i64], row)?.collect()
        };
        read().map_err(StoreError::database(self.path(), "looking for what is due"))
    }

    /// The window of a row of device, boot, number and time.
    pub(crate) fn due_window(&self, row: &Row<'_>) -> rusqlite::Result<DueWindow> {
        Ok(DueWindow {
            day: self.file.day.clone(),
            device: row.get(0)?,
            boot: row.get(1)?,
            seq: row.get(2)?,
            at_ms: row.get(3)?,
        })
    }

    /// Windows of this day that a fleet has not acknowledged.
    pub(crate) fn count_due(&self) -> Result<u64, StoreError> {
        let sql = "SELECT count(*) FROM windows WHERE fleet = 0";
        let count = self
            .connection
            .query_row(sql, [], |row| row.get::<_, i64>(0));
        let count = count.map_err(StoreError::database(self.path(), "counting what is due"))?;
        Ok(u64::try_from(count).unwrap_or(0))
    }
}
