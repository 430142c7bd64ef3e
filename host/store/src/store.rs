//! The writer of a store: devices, sessions, windows as they come.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use ihd_link::Window;
use ihd_model::FleetStates;
use ihd_shared::wire::messages::{FrontEnd, Hello};
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};
use serde::Serialize;

use super::clock::{self, Clock};
use super::folder::{self, DayFile, Lock};
use super::recent::{self, Recent};
use super::retention::{DeletedFiles, checkpoint};
use super::text::printable;
use super::thinning::Thinning;
use super::windows::{Day, InsertOutcome, OpenDays, SampleDropReason};
use super::{DeviceId, SamplePolicy, SessionId, StoreError, StoreOptions, start};

/// A store opened for writing. Its methods block; when one has returned `Ok`, its change is committed.
pub struct Store {
    folder: PathBuf,
    path: PathBuf,
    options: StoreOptions,
    clock: Clock,
    records: Connection,
    pub(crate) days: OpenDays,
    sessions: HashMap<SessionId, Session>,
    /// Bytes of all days but today, and of those set aside.
    pub(crate) other_days_bytes: u64,
    figures: StoreFigures,
    /// Last day up to which no window is due to a fleet; `None` if days were not searched since a window came for one of
    /// them.
    pub(crate) none_due_to: Option<String>,
    /// Counts of windows by their state in the fleet, for days that have not changed since.
    pub(crate) tallies: BTreeMap<String, FleetStates>,
    /// Day for which the lack of room was reported.
    reported_too_large: Option<String>,
    /// Last session of the processes before; `None` once those that were cut off are ended.
    cut_off: Option<SessionId>,
    /// Windows of the last hour.
    pub(crate) recent: Recent,
    /// Progress of thinning older windows.
    pub(crate) thinning: Thinning,
    /// Windows of days whose samples were deleted before the fleet had them, not reported yet.
    pub(crate) lost_to_fleet: BTreeMap<String, u64>,
    /// Files that were deleted to make room, not reported yet.
    pub(crate) deleted: DeletedFiles,
    /// Time of the last collection, by the clock at that time.
    pub(crate) collected_ms: Option<i64>,
    /// Released last.
    _lock: Lock,
}

/// Columns of a window's row that come from its session.
#[derive(Clone)]
pub(crate) struct Session {
    pub(crate) device: DeviceId,
    pub(crate) name: String,
    pub(crate) boot: u32,
    /// Windows so far.
    windows: u32,
}

/// Counters of the store since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StoreFigures {
    /// Windows stored, with their samples or without.
    pub windows: u64,
    /// Windows that came twice.
    pub windows_known: u64,
    /// Windows stored without their samples by policy.
    pub not_kept_by_policy: u64,
    /// Windows stored without their samples because no room could be made.
    pub not_kept_for_size: u64,
    /// Windows whose samples were deleted to make room for newer ones.
    pub thinned: u64,
}

/// Windows may exceed their limit by 1/`EXCESS_DIVISOR` of it until room is made.
const EXCESS_DIVISOR: u64 = 10;

const END_CUT_OFF: &str = "UPDATE sessions SET ended_ms = ?1,
    why = 'cut off: the process ended without ending it' WHERE ended_ms IS NULL AND id <= ?2";

const LAST_CUT_OFF: &str = "SELECT max(id) FROM sessions WHERE ended_ms IS NULL";

const NEW_SESSION: &str = "
INSERT INTO sessions (device, boot, began_ms, build, board, protocol_major, protocol_minor, capabilities,
    reset_reason, fault_before_reset, v_full_scale_mv, i_full_scale_ma, bus_full_scale_mv,
    mains_full_scale_mv, bits)
VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15)";

const SESSION: &str = "SELECT device, devices.name, boot FROM sessions
JOIN devices ON devices.id = sessions.device WHERE sessions.id = ?1";

impl Store {
    pub(crate) fn new(
        folder: &Path,
        options: &StoreOptions,
        clock: Clock,
        records: Connection,
        lock: Lock,
    ) -> Result<Self, StoreError> {
        Ok(Self {
            folder: folder.to_owned(),
            path: folder.join(folder::RECORDS),
            options: *options,
            clock,
            records,
            days: OpenDays::default(),
            sessions: HashMap::new(),
            other_days_bytes: 0,
            figures: StoreFigures::default(),
            none_due_to: None,
            tallies: BTreeMap::new(),
            reported_too_large: None,
            cut_off: None,
            recent: Recent::default(),
            thinning: Thinning::default(),
            lost_to_fleet: BTreeMap::new(),
            deleted: DeletedFiles::default(),
            collected_ms: None,
            _lock: lock,
        })
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the counters since it was opened.
    pub fn figures(&self) -> StoreFigures {
        self.figures
    }

    /// Refuses to write windows or other records from now on, as on a full disk; or writes again.
    #[cfg(feature = "simulation")]
    pub fn refuse_writes(&self, records: bool, windows: bool) {
        let days = self.days.each().map(|day| (&day.connection, windows));
        for (connection, refuses) in days.chain([(&self.records, records)]) {
            connection
                .pragma_update(None, "query_only", refuses)
                .expect("it is no write");
        }
    }

    pub(crate) fn figures_mut(&mut self) -> &mut StoreFigures {
        &mut self.figures
    }

    pub(crate) fn options(&self) -> &StoreOptions {
        &self.options
    }

    pub(crate) fn records(&self) -> &Connection {
        &self.records
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn now(&self) -> i64 {
        (self.clock)()
    }

    pub(crate) fn failed(
        &self,
        doing: &'static str,
    ) -> impl FnOnce(rusqlite::Error) -> StoreError + use<> {
        StoreError::database(&self.path, doing)
    }

    /// Changes `ihd.db` in one transaction: all of it, or nothing.
    pub(crate) fn change<T>(
        &mut self,
        doing: &'static str,
        change: impl FnOnce(&Transaction<'_>) -> rusqlite::Result<T>,
    ) -> Result<T, StoreError> {
        let failed = self.failed(doing);
        let behavior = TransactionBehavior::Immediate;
        let all = || {
            let transaction = self.records.transaction_with_behavior(behavior)?;
            let done = change(&transaction)?;
            transaction.commit()?;
            Ok(done)
        };
        all().map_err(failed)
    }

    /// Returns the device of this name, created if it does not exist, and sets its address.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn device(&mut self, name: &str, address: &str) -> Result<DeviceId, StoreError> {
        let row = params![printable(name), printable(address), self.now()];
        self.change("storing a device", |change| {
            change.query_row(
                "INSERT INTO devices (name, address, first_seen_ms) VALUES (?1, ?2, ?3)
                 ON CONFLICT (name) DO UPDATE SET address = excluded.address RETURNING id",
                row,
                |row| row.get(0),
            )
        })
    }

    /// Records the number of a device's chip. If it was another one before, the learner's state is deleted, the device's lookups are
    /// superseded, and the number before is returned.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn set_chip(&mut self, device: DeviceId, chip: &str) -> Result<Option<String>, StoreError> {
        let at_ms = self.now();
        self.change("storing a chip's number", |change| {
            let sql = "SELECT chip FROM devices WHERE id = ?1";
            let before: Option<String> = change.query_row(sql, [device], |row| row.get(0))?;
            if before.as_deref() == Some(chip) {
                return Ok(None);
            }
            let row = params![device, chip];
            change.execute("UPDATE devices SET chip = ?2 WHERE id = ?1", row)?;
            if before.is_some() {
                change.execute("DELETE FROM learned WHERE device = ?1", [device])?;
                change.execute(
                    "UPDATE lookups SET state = 'superseded', at_ms = ?2
                     WHERE device = ?1 AND state IN ('active', 'pending')",
                    params![device, at_ms],
                )?;
            }
            Ok(before)
        })
    }

    /// Begins a session, after the handshake of a connection.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn begin_session(
        &mut self,
        device: DeviceId,
        hello: &Hello,
        front_end: &FrontEnd,
    ) -> Result<SessionId, StoreError> {
        self.end_sessions_that_were_cut_off()?;
        let at_ms = self.now();
        let session = self.change("storing a session", |change| {
            change.execute(
                NEW_SESSION,
                params![
                    device,
                    hello.boot_id,
                    at_ms,
                    printable(&hello.build),
                    printable(&hello.board),
                    hello.protocol_major,
                    hello.protocol_minor,
                    hello.capabilities,
                    hello.reset_reason,
                    hello.fault_before_reset,
                    front_end.v_full_scale_mv,
                    front_end.i_full_scale_ma,
                    front_end.bus_full_scale_mv,
                    front_end.mains_full_scale_mv,
                    front_end.bits,
                ],
            )?;
            Ok(change.last_insert_rowid())
        })?;
        self.session(session)?;
        Ok(session)
    }

    /// Ends a session.
    ///
    /// # Errors
    /// [`StoreError::NoSession`], or an error of the database.
    pub fn end_session(&mut self, session: SessionId, why: &str) -> Result<(), StoreError> {
        let row = params![session, self.now(), printable(why)];
        let ended = self.change("ending a session", |change| {
            let sql = "UPDATE sessions SET ended_ms = ?2, why = ?3 WHERE id = ?1";
            change.execute(sql, row)
        })?;
        self.sessions.remove(&session);
        match ended {
            0 => Err(StoreError::NoSession { session }),
            _ => Ok(()),
        }
    }

    /// Finds the sessions that the processes before have not ended.
    pub(crate) fn find_sessions_that_were_cut_off(&mut self) -> Result<(), StoreError> {
        let last = self.records.query_row(LAST_CUT_OFF, [], |row| row.get(0));
        self.cut_off = last.map_err(self.failed("looking for open sessions"))?;
        Ok(())
    }

    /// Ends the sessions that the processes before have not ended. After an error they end with the next session's begin or the next
    /// collection.
    pub(crate) fn end_sessions_that_were_cut_off(&mut self) -> Result<(), StoreError> {
        let Some(last) = self.cut_off else {
            return Ok(());
        };
        let at_ms = self.now();
        self.change("ending sessions", |change| {
            change.execute(END_CUT_OFF, [at_ms, last]).map(drop)
        })?;
        self.cut_off = None;
        Ok(())
    }

    pub(crate) fn session(&mut self, session: SessionId) -> Result<&mut Session, StoreError> {
        use std::collections::hash_map::Entry;
        match self.sessions.entry(session) {
            Entry::Occupied(known) => Ok(known.into_mut()),
            Entry::Vacant(vacant) => {
                let row = self
                    .records
                    .query_row(SESSION, [session], |row| {
                        Ok(Session {
                            device: row.get(0)?,
                            name: row.get(1)?,
                            boot: row.get(2)?,
                            windows: 0,
                        })
                    })
                    .optional()
                    .map_err(StoreError::database(&self.path, "reading a session"))?;
                let row = row.ok_or(StoreError::NoSession { session })?;
                Ok(vacant.insert(row))
            }
        }
    }

    /// Stores a window: its row always, its samples by the policy.
    ///
    /// # Errors
    /// [`StoreError::NoSession`], or an error of the database or the operating system.
    pub fn keep_window(
        &mut self,
        session: SessionId,
        window: &Window,
    ) -> Result<InsertOutcome, StoreError> {
        Ok(self.keep_window_for(session, window, false)?.0)
    }

    /// Stores a window, due to the fleet in the same transaction if `for_fleet`. The second value is `false` if the fleet will not get
    /// it: it is not for the fleet, or its samples are not stored.
    ///
    /// # Errors
    /// The same as for [`Store::keep_window`].
    pub fn keep_window_for(
        &mut self,
        session: SessionId,
        window: &Window,
        for_fleet: bool,
    ) -> Result<(InsertOutcome, bool), StoreError> {
        match self.keep(session, window, for_fleet) {
            Err(error) if error.is_damage() => {
                self.set_today_aside(&error)?;
                self.keep(session, window, for_fleet)
            }
            result => result,
        }
    }

    fn keep(
        &mut self,
        session: SessionId,
        window: &Window,
        for_fleet: bool,
    ) -> Result<(InsertOutcome, bool), StoreError> {
        let Session {
            name,
            boot,
            windows,
            ..
        } = self.session(session)?.clone();
        let at_ms = self.now();
        self.turn_to(&clock::day(at_ms))?;
        let before = self.days.before.as_ref();
        if before.map_or(Ok(false), |day| day.holds(&name, boot, window.seq))? {
            self.figures.windows_known += 1;
            return Ok((InsertOutcome::Known, false));
        }
        let not_kept = self.sample_drop_reason(windows)?;
        let Some(today) = &self.days.today else {
            // Unreachable: `turn_to` has opened the day.
            return Err(StoreError::NoStore {
                folder: self.folder.clone(),
            });
        };
        let outcome = today.insert(&name, boot, at_ms, window, not_kept, for_fleet)?;
        let is_due = for_fleet && not_kept.is_none();
        if is_due && self.none_due_to.as_ref() >= Some(&today.file.day) {
            self.none_due_to = None;
        }
        if outcome == InsertOutcome::New {
            self.tallies.remove(&today.file.day);
            let row = today.connection.last_insert_rowid();
            self.recent.note(&today.file.day, row, at_ms);
        }
        self.count(outcome, not_kept);
        if outcome == InsertOutcome::New {
            self.session(session)?.windows = windows.wrapping_add(1);
        }
        Ok((outcome, is_due))
    }

    /// Returns the reason for which a window's samples are not stored; `windows` of its session came before.
    fn sample_drop_reason(&mut self, windows: u32) -> Result<Option<SampleDropReason>, StoreError> {
        if let SamplePolicy::OneIn(n) = self.options.keep
            && !windows.is_multiple_of(n.max(1))
        {
            return Ok(Some(SampleDropReason::Policy));
        }
        if let Err(error) = self.make_room() {
            tracing::warn!(%error, "room for newer windows could not be made");
        }
        let max = self.options.retention.max_bytes;
        if self.excess_bytes()? <= max / EXCESS_DIVISOR {
            return Ok(None);
        }
        let today = self.days.today.as_ref().map(|day| day.file.day.clone());
        if self.reported_too_large != today {
            let text = format!(
                "today's windows take all of the {max} bytes that windows may: their samples are not kept"
            );
            tracing::warn!("{text}");
            self.notice("store", &text);
            self.reported_too_large = today;
        }
        Ok(Some(SampleDropReason::Size))
    }

    fn count(&mut self, outcome: InsertOutcome, not_kept: Option<SampleDropReason>) {
        let figures = &mut self.figures;
        match (outcome, not_kept) {
            (InsertOutcome::Known, _) => {
                figures.windows_known += 1;
                return;
            }
            (InsertOutcome::New, Some(SampleDropReason::Size)) => figures.not_kept_for_size += 1,
            (InsertOutcome::New, Some(_)) => figures.not_kept_by_policy += 1,
            (InsertOutcome::New, None) => {}
        }
        figures.windows += 1;
    }

    /// Opens the day's file; yesterday's stays open for late results.
    pub(crate) fn turn_to(&mut self, day: &str) -> Result<(), StoreError> {
        if self.days.today.as_ref().is_some_and(|t| t.file.day == day) {
            return Ok(());
        }
        let path = folder::of_day(&self.folder, day);
        let file = DayFile {
            day: day.to_owned(),
            path,
        };
        let before = match self.days.today.take() {
            Some(before) => Some(before),
            None => self.last_day_before(day)?,
        };
        self.days.before = before.filter(|before| before.file.day != day);
        if let Some(before) = &self.days.before {
            // From now on its size on disk counts.
            checkpoint(&before.connection);
        }
        let today = Day::open(file)?;
        self.days.today = Some(today);
        self.days.thinned = None;
        self.thinning = Thinning::default();
        self.measure_other_days()?;
        self.delete_by_age()?;
        Ok(())
    }

    /// Finds the stored windows of the last hour, by their order and not by the clock.
    pub(crate) fn resume_recent(&mut self) -> Result<(), StoreError> {
        let mut left_ms = recent::LAST_MS;
        for file in folder::days(&self.folder)?.into_iter().rev() {
            let day = Day::open(file)?;
            let (first, span_ms) = day.first_row_within(left_ms)?;
            self.recent.resume(&day.file.day, first);
            left_ms -= span_ms + recent::MAX_STEP_MS;
            if left_ms <= 0 {
                break;
            }
        }
        Ok(())
    }

    fn last_day_before(&self, day: &str) -> Result<Option<Day>, StoreError> {
        let mut days = folder::days(&self.folder)?;
        days.retain(|file| *file.day < *day);
        days.pop().map(Day::open).transpose()
    }

    /// Sets a day's file aside that was damaged while it was opened or written; the store continues with a new one.
    pub(crate) fn set_today_aside(&mut self, error: &StoreError) -> Result<(), StoreError> {
        let (StoreError::Damaged { file, .. } | StoreError::Database { file, .. }) = error else {
            return Ok(());
        };
        self.days = OpenDays::default();
        self.tallies.clear();
        if *file == self.path {
            return Ok(());
        }
        let damage = folder::set_aside(file, error.to_string(), self.now())?;
        tracing::error!("{}", start::describe(&damage));
        self.notice("damage", &start::describe(&damage));
        Ok(())
    }

    /// Deletes a window's samples if they are stored. A failure is only logged: a collection does
    /// it later.
    pub(crate) fn drop_samples(&self, name: &str, boot: u32, seq: u32, why: SampleDropReason) {
        for day in self.days.each() {
            match day.drop_samples(name, boot, seq, why) {
                Ok(true) => return,
                Ok(false) => {}
                Err(error) => tracing::warn!("{error}"),
            }
        }
    }
}
