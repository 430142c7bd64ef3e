//! What a fleet has not acknowledged yet: the store is the edge's outbox (docs/fleet.md).

use std::hash::{BuildHasher, Hasher, RandomState};

use ihd_link::Window;
use rusqlite::{OptionalExtension, Row, params};

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
SELECT device, boot, seq, at_ms FROM windows WHERE fleet = 0 ORDER BY at_ms, id LIMIT ?1";

/// How far a window is with a fleet; never back.
const NOTE: &str = "UPDATE windows SET fleet = ?4
    WHERE device = ?1 AND boot = ?2 AND seq = ?3 AND fleet < ?4";

/// What `windows.fleet` says beside 0, due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The fleet has the window, and owes a result.
    Window = 1,
    /// There is a result, here and there.
    Result = 2,
}

/// Progress of a window with a fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetState {
    /// The fleet is not to have it.
    NotForFleet,
    /// The fleet has not acknowledged it.
    Due,
    /// The fleet has it, and owes a result.
    Sent,
    /// There is a result, here and there.
    Answered,
}

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

    /// The fleet has acknowledged these.
    ///
    /// # Errors
    /// What the databases report; those of days before have been noted.
    pub fn sent(&mut self, sent: &[(DueWindow, Sent)]) -> Result<(), StoreError> {
        for of_day in sent.chunk_by(|(a, _), (b, _)| a.day == b.day) {
            let file = self.file_of(&of_day[0].0.day);
            if file.path.exists() {
                self.on_day(file, |day| day.note(of_day))?;
            }
        }
        Ok(())
    }

    /// The fleet has answered a window, of whatever day.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn answered(&mut self, device: &str, boot: u32, seq: u32) -> Result<(), StoreError> {
        let mut days = folder::days(self.folder())?;
        days.reverse();
        for file in days {
            if self.on_day(file, |day| day.answered(device, boot, seq))? {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Windows that were sent before a time (milliseconds since 1970, UTC) and never answered are due again: the fleet has lost them, or
    /// their results. How many.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn due_again(&mut self, before_ms: i64) -> Result<u64, StoreError> {
        let mut again = 0;
        for file in folder::days(self.folder())? {
            again += self.on_day(file, |day| day.due_again(before_ms))?;
        }
        if again > 0 {
            self.none_due_to = None;
        }
        Ok(again)
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

    /// Progress of a window of whatever day with a fleet; `None` if the store does not hold it.
    ///
    /// # Errors
    /// What the databases or the operating system report.
    pub fn fleet_state(
        &mut self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<FleetState>, StoreError> {
        let mut days = folder::days(self.folder())?;
        days.reverse();
        for file in days {
            let state = self.on_day(file, |day| day.fleet_state(device, boot, seq))?;
            if state.is_some() {
                return Ok(state);
            }
        }
        Ok(None)
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

    fn file_of(&self, day: &str) -> DayFile {
        DayFile {
            day: day.to_owned(),
            path: folder::of_day(self.folder(), day),
        }
    }

    /// Does something with a day, open or not.
    fn on_day<T>(
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
            let row = |row: &Row<'_>| {
                Ok(DueWindow {
                    day: self.file.day.clone(),
                    device: row.get(0)?,
                    boot: row.get(1)?,
                    seq: row.get(2)?,
                    at_ms: row.get(3)?,
                })
            };
            statement.query_map([limit as i64], row)?.collect()
        };
        read().map_err(StoreError::database(self.path(), "looking for what is due"))
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

    fn note(&self, sent: &[(DueWindow, Sent)]) -> Result<(), StoreError> {
        let note = || {
            let change = self.connection.unchecked_transaction()?;
            for (due, sent) in sent {
                change.execute(NOTE, params![due.device, due.boot, due.seq, *sent as i64])?;
            }
            change.commit()
        };
        note().map_err(StoreError::database(self.path(), "noting what was sent"))
    }

    /// False where the window is none of this day.
    fn answered(&self, device: &str, boot: u32, seq: u32) -> Result<bool, StoreError> {
        let of = params![device, boot, seq, Sent::Result as i64];
        let rows = self.connection.execute(NOTE, of);
        let rows = rows.map_err(StoreError::database(self.path(), "noting an answer"))?;
        match rows {
            0 => self.holds(device, boot, seq),
            _ => Ok(true),
        }
    }

    fn fleet_state(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<FleetState>, StoreError> {
        let sql = "SELECT fleet FROM windows WHERE device = ?1 AND boot = ?2 AND seq = ?3";
        let state = self
            .connection
            .query_row(sql, params![device, boot, seq], |row| {
                row.get::<_, Option<i64>>(0)
            })
            .optional();
        let state = state.map_err(StoreError::database(self.path(), "looking for a window"))?;
        Ok(state.map(|fleet| match fleet {
            Some(0) => FleetState::Due,
            Some(1) => FleetState::Sent,
            Some(_) => FleetState::Answered,
            None => FleetState::NotForFleet,
        }))
    }

    fn due_again(&self, before_ms: i64) -> Result<u64, StoreError> {
        let sql = "UPDATE windows SET fleet = 0 WHERE fleet = 1 AND at_ms < ?1";
        let rows = self.connection.execute(sql, [before_ms]);
        let rows = rows.map_err(StoreError::database(self.path(), "looking for answers"))?;
        Ok(rows as u64)
    }
}
