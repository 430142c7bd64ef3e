//! Database of one day's windows.

use std::path::{Path, PathBuf};

use ihd_link::Window;
use ihd_shared::sampling::Scales;
use rusqlite::{Connection, OptionalExtension, Row, params};
use serde::Serialize;

use super::folder::DayFile;
use super::schema::WINDOWS;
use super::{StoreError, database, payload};

mod room;

/// Result of storing a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InsertOutcome {
    /// Stored now.
    New,
    /// Stored before: it came twice.
    Known,
}

/// Reason for which a window's samples are not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SampleDropReason {
    /// Left out by the policy of one in N.
    Policy,
    /// Accepted by the gate, without effect on the lookup.
    Uninformative,
    /// Today's windows take all the room.
    Size,
    /// Deleted to make room for newer windows.
    Thinned,
}

impl SampleDropReason {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Policy => "policy",
            Self::Uninformative => "tells nothing",
            Self::Size => "size",
            Self::Thinned => "thinned",
        }
    }
}

/// A window's row without its samples.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct WindowRow {
    /// The device's name.
    pub device: String,
    /// The device's boot.
    pub boot: u32,
    /// Number since the boot; windows that the device dropped count too.
    pub seq: u32,
    /// Time at which it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Half-cycle since the boot.
    pub half_cycle: u32,
    /// Switching frequency, in hertz.
    pub f_sw_hz: u32,
    /// Pairs of samples.
    pub pairs: u32,
    /// Reason for which its samples are not stored; `None` if they are.
    pub not_kept: Option<String>,
    /// Bytes that its samples and trajectory take, packed.
    pub packed_bytes: u32,
}

/// Filter of windows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WindowFilter {
    /// Only this device's, by its name.
    pub device: Option<String>,
    /// Only those stored at this time or later, in milliseconds since 1970, UTC.
    pub since_ms: Option<i64>,
    /// Only those of this boot.
    pub boot: Option<u32>,
    /// Only the one of this number.
    pub seq: Option<u32>,
}

/// `windows.fleet_end` of a window that was given up because it has no samples any more.
pub(crate) const NO_SAMPLES: &str = "no samples";

/// A day's database, open.
pub(crate) struct Day {
    pub(crate) file: DayFile,
    pub(crate) connection: Connection,
}

const INSERT: &str = "
INSERT INTO windows (device, boot, seq, at_ms, half_cycle, f_sw_hz, half_cycle_ns, first_pair_ns,
    first_trajectory_ns, saturated, lookup_version, v_full_scale_mv, i_full_scale_ma, pairs, trajectory,
    not_kept, pairs_zst, trajectory_zst, fleet, fleet_ms)
VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, iif(?19 IS NULL, NULL, ?4))
ON CONFLICT (device, boot, seq) DO NOTHING";

const ROWS: &str = "
SELECT device, boot, seq, at_ms, half_cycle, f_sw_hz, pairs, not_kept,
    coalesce(length(pairs_zst) + length(trajectory_zst), 0)
FROM windows
WHERE (?1 IS NULL OR device = ?1) AND (?2 IS NULL OR at_ms >= ?2) AND (?3 IS NULL OR boot = ?3)
    AND (?4 IS NULL OR seq = ?4)
ORDER BY device, boot, seq";

const LAST: &str = "
SELECT device, boot, seq, at_ms, half_cycle, f_sw_hz, pairs, not_kept,
    coalesce(length(pairs_zst) + length(trajectory_zst), 0)
FROM windows WHERE device = ?1 AND (?3 = 0 OR not_kept IS NULL)
ORDER BY at_ms DESC, id DESC LIMIT ?2";

const ROW: &str = "
SELECT device, boot, seq, at_ms, half_cycle, f_sw_hz, pairs, not_kept,
    coalesce(length(pairs_zst) + length(trajectory_zst), 0)
FROM windows WHERE device = ?1 AND boot = ?2 AND seq = ?3";

const WHOLE: &str = "
SELECT half_cycle, f_sw_hz, half_cycle_ns, first_pair_ns, first_trajectory_ns, saturated, lookup_version,
    v_full_scale_mv, i_full_scale_ma, pairs, trajectory, pairs_zst, trajectory_zst
FROM windows WHERE device = ?1 AND boot = ?2 AND seq = ?3";

impl Day {
    /// Opens a day for writing, and creates its file if it does not exist.
    pub(crate) fn open(file: DayFile) -> Result<Self, StoreError> {
        let connection = database::open(&file.path, &WINDOWS)?;
        Ok(Self { file, connection })
    }

    /// Opens a day for reading; `None` if it was deleted since the folder was read.
    pub(crate) fn open_to_read(file: DayFile) -> Result<Option<Self>, StoreError> {
        match database::open_to_read(&file.path, &WINDOWS) {
            Err(_) if !file.path.exists() => Ok(None),
            opened => opened.map(|connection| Some(Self { file, connection })),
        }
    }

    fn failed(&self, doing: &'static str) -> impl FnOnce(rusqlite::Error) -> StoreError {
        StoreError::database(&self.file.path, doing)
    }

    /// Stores a window, with its samples or with the reason for which they are not; due to the fleet if `for_fleet`.
    pub(crate) fn insert(
        &self,
        device: &str,
        boot: u32,
        at_ms: i64,
        window: &Window,
        not_kept: Option<SampleDropReason>,
        for_fleet: bool,
    ) -> Result<InsertOutcome, StoreError> {
        let packing = || StoreError::files(&self.file.path, "packing a window");
        let payload = match not_kept {
            None => Some(payload::pack(window).map_err(packing())?),
            Some(_) => None,
        };
        let rows = self.connection.execute(
            INSERT,
            params![
                device,
                boot,
                window.seq,
                at_ms,
                window.half_cycle,
                window.f_sw_hz,
                window.half_cycle_ns,
                window.first_pair_ns,
                window.first_trajectory_ns,
                window.saturated,
                window.lookup_version,
                window.scales.v_full_scale_mv,
                window.scales.i_full_scale_ma,
                window.pairs.len() as i64,
                window.trajectory.len() as i64,
                not_kept.map(SampleDropReason::as_str),
                payload.as_ref().map(|p| p.pairs.as_slice()),
                payload.as_ref().map(|p| p.trajectory.as_slice()),
                (for_fleet && not_kept.is_none()).then_some(0),
            ],
        );
        match rows.map_err(self.failed("storing a window"))? {
            0 => Ok(InsertOutcome::Known),
            _ => Ok(InsertOutcome::New),
        }
    }

    /// Returns `true` if it holds a window, with samples or without.
    pub(crate) fn holds(&self, device: &str, boot: u32, seq: u32) -> Result<bool, StoreError> {
        let exists = self.connection.query_row(
            "SELECT EXISTS (SELECT 1 FROM windows WHERE device = ?1 AND boot = ?2 AND seq = ?3)",
            params![device, boot, seq],
            |row| row.get(0),
        );
        exists.map_err(self.failed("looking for a window"))
    }

    /// Returns the time at which a window of a device was stored; `None` if it is not of this day.
    pub(crate) fn time(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<i64>, StoreError> {
        let sql = "SELECT at_ms FROM windows WHERE device = ?1 AND boot = ?2 AND seq = ?3";
        let of = params![device, boot, seq];
        let time = self.connection.query_row(sql, of, |row| row.get(0));
        time.optional().map_err(self.failed("looking for a window"))
    }

    /// Returns the windows that match a filter, in order of device, boot and number.
    pub(crate) fn rows(&self, filter: &WindowFilter) -> Result<Vec<WindowRow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<WindowRow>> {
            let mut statement = self.connection.prepare(ROWS)?;
            let of = params![filter.device, filter.since_ms, filter.boot, filter.seq];
            statement.query_map(of, window_row)?.collect()
        };
        read().map_err(self.failed("listing windows"))
    }

    /// Returns the row of a window; `None` if there is none.
    pub(crate) fn row(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<WindowRow>, StoreError> {
        let of = params![device, boot, seq];
        let row = self.connection.query_row(ROW, of, window_row).optional();
        row.map_err(self.failed("reading a window"))
    }

    /// Returns the last windows of a device, newest first; only those with samples if `whole`.
    pub(crate) fn last_rows(
        &self,
        device: &str,
        limit: usize,
        whole: bool,
    ) -> Result<Vec<WindowRow>, StoreError> {
        let read = || -> rusqlite::Result<Vec<WindowRow>> {
            let mut statement = self.connection.prepare(LAST)?;
            let of = params![device, limit as i64, whole];
            statement.query_map(of, window_row)?.collect()
        };
        read().map_err(self.failed("listing windows"))
    }

    /// Returns a window; `None` if it, or its samples, are not stored.
    pub(crate) fn window(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
    ) -> Result<Option<Window>, StoreError> {
        let stored = self
            .connection
            .query_row(WHOLE, params![device, boot, seq], |row| {
                StoredWindow::read(row, seq)
            })
            .optional()
            .map_err(self.failed("reading a window"))?;
        let Some(stored) = stored.flatten() else {
            return Ok(None);
        };
        let unpacked = stored.unpack().map_err(|why| StoreError::Window {
            file: self.file.path.clone(),
            device: device.to_owned(),
            boot,
            seq,
            why,
        });
        unpacked.map(Some)
    }

    /// Returns device, boot and number of every window with samples, in the order in which they came.
    pub(crate) fn keys(&self) -> Result<Vec<(String, u32, u32)>, StoreError> {
        let read = || -> rusqlite::Result<Vec<_>> {
            let mut statement = self.connection.prepare(
                "SELECT device, boot, seq FROM windows INDEXED BY windows_with_samples
                 WHERE not_kept IS NULL ORDER BY id",
            )?;
            statement
                .query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?
                .collect()
        };
        read().map_err(self.failed("listing windows"))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.file.path
    }
}

fn window_row(row: &Row<'_>) -> rusqlite::Result<WindowRow> {
    Ok(WindowRow {
        device: row.get(0)?,
        boot: row.get(1)?,
        seq: row.get(2)?,
        at_ms: row.get(3)?,
        half_cycle: row.get(4)?,
        f_sw_hz: row.get(5)?,
        pairs: row.get(6)?,
        not_kept: row.get(7)?,
        packed_bytes: row.get(8)?,
    })
}

/// Stored row of a window.
struct StoredWindow {
    window: Window,
    counts: [usize; 2],
    packed: [Vec<u8>; 2],
}

impl StoredWindow {
    /// Reads a row; `None` if its samples are not stored.
    fn read(row: &Row<'_>, seq: u32) -> rusqlite::Result<Option<Self>> {
        let (Some(pairs), Some(trajectory)) = (row.get(11)?, row.get(12)?) else {
            return Ok(None);
        };
        let count = |k: usize| row.get::<_, u32>(k).map(|n| n as usize);
        Ok(Some(Self {
            window: Window {
                seq,
                half_cycle: row.get(0)?,
                f_sw_hz: row.get(1)?,
                half_cycle_ns: row.get(2)?,
                first_pair_ns: row.get(3)?,
                pairs: Vec::new(),
                first_trajectory_ns: row.get(4)?,
                trajectory: Vec::new(),
                saturated: row.get(5)?,
                lookup_version: row.get(6)?,
                scales: Scales {
                    v_full_scale_mv: row.get(7)?,
                    i_full_scale_ma: row.get(8)?,
                },
            },
            counts: [count(9)?, count(10)?],
            packed: [pairs, trajectory],
        }))
    }

    fn unpack(self) -> Result<Window, String> {
        Ok(Window {
            pairs: payload::pairs(&self.packed[0], self.counts[0])?,
            trajectory: payload::trajectory(&self.packed[1], self.counts[1])?,
            ..self.window
        })
    }
}

/// Open days: today's, the one before, whose results still come after midnight, and the one that is being thinned.
#[derive(Default)]
pub(crate) struct OpenDays {
    pub(crate) today: Option<Day>,
    pub(crate) before: Option<Day>,
    pub(crate) thinned: Option<Day>,
}

impl OpenDays {
    pub(crate) fn each(&self) -> impl Iterator<Item = &Day> {
        self.today.iter().chain(&self.before).chain(&self.thinned)
    }

    /// Closes a day's database if it is open.
    pub(crate) fn close(&mut self, path: &PathBuf) {
        for day in [&mut self.today, &mut self.before, &mut self.thinned] {
            if day.as_ref().is_some_and(|open| open.file.path == *path) {
                *day = None;
            }
        }
    }
}
