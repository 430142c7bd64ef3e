//! Results of windows, and the learner's state.

use rusqlite::{Connection, OptionalExtension, Row, Transaction, params};

use super::text::printable;
use super::windows::SampleDropReason;
use super::{DeviceId, ResultId, SamplePolicy, SessionId, Store, StoreError};

/// Most rows of a filter without a limit.
const DEFAULT_LIMIT: u32 = 100;

/// Result of a window, to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewResult {
    /// The session in which it came.
    pub session: SessionId,
    /// The window's number since the device's boot.
    pub seq: u32,
    /// Half-cycle since the device's boot.
    pub half_cycle: u32,
    /// Switching frequency, in hertz.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean power of the half-cycle, in watt; `None` if unknown.
    pub power_w: Option<f64>,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: f64,
    /// Mean of L weighted with the squared current, in henry.
    pub l_h: f64,
    /// Standard deviation of R, in percent.
    pub sigma_r_pct: f64,
    /// Standard deviation of L, in percent.
    pub sigma_l_pct: f64,
    /// `true` if the gate accepts it.
    pub pass: bool,
    /// Reason of the gate's refusal; empty if it accepts.
    pub why: String,
    /// `true` if it led to a new lookup.
    pub changed_lookup: bool,
    /// Iterations of the training.
    pub iterations: u32,
}

/// Stored result of a window. Numbers that were not finite are NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultRow {
    /// Its number.
    pub id: ResultId,
    /// The device's name.
    pub device: String,
    /// The device's boot.
    pub boot: u32,
    /// The window's number since the boot.
    pub seq: u32,
    /// The session in which it came.
    pub session: SessionId,
    /// Half-cycle since the boot.
    pub half_cycle: u32,
    /// Time at which its window was stored, in milliseconds since 1970, UTC; its own if there is no such window.
    pub at_ms: i64,
    /// Switching frequency, in hertz.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean power of the half-cycle, in watt; `None` if unknown.
    pub power_w: Option<f64>,
    /// Mean of R weighted with the squared current, in ohm.
    pub r_ohm: f64,
    /// Mean of L weighted with the squared current, in henry.
    pub l_h: f64,
    /// Standard deviation of R, in percent.
    pub sigma_r_pct: f64,
    /// Standard deviation of L, in percent.
    pub sigma_l_pct: f64,
    /// `true` if the gate accepts it.
    pub pass: bool,
    /// Reason of the gate's refusal; empty if it accepts.
    pub why: String,
    /// `true` if it led to a new lookup.
    pub changed_lookup: bool,
    /// Iterations of the training.
    pub iterations: u32,
}

/// Filter of results.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ResultFilter {
    /// Only this device's, by its name.
    pub device: Option<String>,
    /// Only those of windows stored at this time or later, in milliseconds since 1970, UTC.
    pub since_ms: Option<i64>,
    /// Most rows; 100 if `None`.
    pub limit: Option<u32>,
}

const INSERT: &str = "
INSERT INTO results (session, device, boot, seq, half_cycle, at_ms, f_sw_hz, i_crest_a, power_w, r_ohm,
    l_h, sigma_r_pct, sigma_l_pct, pass, why, changed_lookup, iterations)
VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17)
ON CONFLICT (device, boot, seq) DO UPDATE SET session = excluded.session, at_ms = excluded.at_ms,
    half_cycle = excluded.half_cycle, f_sw_hz = excluded.f_sw_hz, i_crest_a = excluded.i_crest_a,
    power_w = excluded.power_w, r_ohm = excluded.r_ohm, l_h = excluded.l_h,
    sigma_r_pct = excluded.sigma_r_pct, sigma_l_pct = excluded.sigma_l_pct, pass = excluded.pass,
    why = excluded.why, changed_lookup = excluded.changed_lookup, iterations = excluded.iterations
RETURNING id";

const COLUMNS: &str = "
SELECT results.id, devices.name, boot, seq, session, half_cycle, at_ms, f_sw_hz, i_crest_a, power_w,
    r_ohm, l_h, sigma_r_pct, sigma_l_pct, pass, why, changed_lookup, iterations
FROM results JOIN devices ON devices.id = results.device";

/// Stores a device's state in a table that has one row for each device.
fn put_state(
    change: &Transaction<'_>,
    table: &str,
    device: DeviceId,
    at_ms: i64,
    state: &[u8],
) -> rusqlite::Result<()> {
    let sql = format!(
        "INSERT INTO {table} (device, at_ms, state) VALUES (?1, ?2, ?3)
         ON CONFLICT (device) DO UPDATE SET at_ms = excluded.at_ms, state = excluded.state"
    );
    change
        .execute(&sql, params![device, at_ms, state])
        .map(drop)
}

/// Returns the results that match a filter, newest first.
pub(crate) fn rows(
    connection: &Connection,
    filter: &ResultFilter,
) -> rusqlite::Result<Vec<ResultRow>> {
    let limit = filter.limit.unwrap_or(DEFAULT_LIMIT);
    let since_ms = filter.since_ms.unwrap_or(i64::MIN);
    // Two statements, because each has an index of its own.
    let (of_device, order) = match &filter.device {
        Some(_) => (
            "results.device = (SELECT id FROM devices WHERE name = ?3)",
            "ORDER BY results.device DESC, at_ms DESC, results.id DESC",
        ),
        None => ("?3 IS NULL", "ORDER BY at_ms DESC, results.id DESC"),
    };
    let sql = format!("{COLUMNS} WHERE at_ms >= ?1 AND {of_device} {order} LIMIT ?2");
    let mut statement = connection.prepare(&sql)?;
    let rows = statement.query_map(params![since_ms, limit, filter.device], row)?;
    rows.collect()
}

/// Returns one result; `None` if there is none of this number.
pub(crate) fn one(connection: &Connection, id: ResultId) -> rusqlite::Result<Option<ResultRow>> {
    let sql = format!("{COLUMNS} WHERE results.id = ?1");
    connection.query_row(&sql, [id], row).optional()
}

fn row(row: &Row<'_>) -> rusqlite::Result<ResultRow> {
    let real = |k: usize| row.get::<_, Option<f64>>(k);
    let number = |k: usize| real(k).map(|x| x.unwrap_or(f64::NAN));
    Ok(ResultRow {
        id: row.get(0)?,
        device: row.get(1)?,
        boot: row.get(2)?,
        seq: row.get(3)?,
        session: row.get(4)?,
        half_cycle: row.get(5)?,
        at_ms: row.get(6)?,
        f_sw_hz: row.get(7)?,
        i_crest_a: number(8)?,
        power_w: real(9)?,
        r_ohm: number(10)?,
        l_h: number(11)?,
        sigma_r_pct: number(12)?,
        sigma_l_pct: number(13)?,
        pass: row.get(14)?,
        why: row.get(15)?,
        changed_lookup: row.get(16)?,
        iterations: row.get(17)?,
    })
}

/// Last accepted result at a frequency and current.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastAccepted {
    /// Number of the result.
    pub last: ResultId,
    /// Time at which its window was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Its switching frequency, in hertz.
    pub f_sw_hz: u32,
    /// Largest amplitude of the current's fundamental among the results at this point, in ampere.
    pub i_crest_a: f64,
}

/// Returns the last accepted result of each frequency and ampere, of those with a number above `after`.
pub(crate) fn last_accepted(
    connection: &Connection,
    device: &str,
    after: ResultId,
) -> rusqlite::Result<Vec<LastAccepted>> {
    // The plus sign keeps SQLite from the index over the device: the range of numbers is far smaller.
    let mut statement = connection.prepare(
        "SELECT max(id), max(at_ms), f_sw_hz, max(i_crest_a) FROM results
         WHERE id > ?2 AND pass = 1 AND i_crest_a IS NOT NULL
             AND +device = (SELECT id FROM devices WHERE name = ?1)
         GROUP BY f_sw_hz, CAST(i_crest_a AS INTEGER)",
    )?;
    let rows = statement.query_map(params![device, after], |row| {
        Ok(LastAccepted {
            last: row.get(0)?,
            at_ms: row.get(1)?,
            f_sw_hz: row.get(2)?,
            i_crest_a: row.get(3)?,
        })
    })?;
    rows.collect()
}

/// Returns the result of a window; `None` if there is none.
pub(crate) fn of_window(
    connection: &Connection,
    device: &str,
    boot: u32,
    seq: u32,
) -> rusqlite::Result<Option<ResultRow>> {
    let sql = format!("{COLUMNS} WHERE devices.name = ?1 AND boot = ?2 AND seq = ?3");
    let of = params![device, boot, seq];
    connection.query_row(&sql, of, row).optional()
}

/// Returns the results of a stretch of time; if they are more than `limit`, one for each of `limit` parts of it.
pub(crate) fn between(
    connection: &Connection,
    device: &str,
    (from_ms, to_ms): (i64, i64),
    limit: usize,
) -> rusqlite::Result<(u64, Vec<ResultRow>)> {
    let sql = "SELECT id FROM devices WHERE name = ?1";
    let id: Option<DeviceId> = connection
        .query_row(sql, [device], |row| row.get(0))
        .optional()?;
    let Some(id) = id else {
        return Ok((0, Vec::new()));
    };
    let of: i64 = connection.query_row(
        "SELECT count(*) FROM results WHERE device = ?1 AND at_ms >= ?2 AND at_ms < ?3",
        params![id, from_ms, to_ms],
        |row| row.get(0),
    )?;
    let of = u64::try_from(of).unwrap_or(0);
    let sql = format!(
        "{COLUMNS} WHERE results.device = ?1 AND at_ms >= ?2 AND at_ms < ?3
         ORDER BY at_ms, results.id LIMIT ?4"
    );
    let mut statement = connection.prepare(&sql)?;
    let mut some = |from_ms: i64, to_ms: i64, limit: usize| -> rusqlite::Result<Vec<ResultRow>> {
        let of = params![id, from_ms, to_ms, limit as i64];
        statement.query_map(of, row)?.collect()
    };
    if of <= limit as u64 {
        return Ok((of, some(from_ms, to_ms, limit)?));
    }
    let mut rows = Vec::with_capacity(limit);
    let span_ms = to_ms.saturating_sub(from_ms) as f64;
    let edge = |k: usize| from_ms.saturating_add((span_ms * k as f64 / limit as f64) as i64);
    for k in 0..limit {
        rows.extend(some(edge(k), edge(k + 1), 1)?);
    }
    Ok((of, rows))
}

impl Store {
    /// Stores the result of a window and, in the same transaction, the state of the device's learner
    /// if given. A second result of a window replaces the first.
    ///
    /// # Errors
    /// [`StoreError::NoSession`], or an error of the database.
    pub fn record_result(
        &mut self,
        result: &NewResult,
        learner_state: Option<&[u8]>,
    ) -> Result<ResultId, StoreError> {
        let session = self.session(result.session)?;
        let (device, boot) = (session.device, session.boot);
        let name = session.name.clone();
        let now_ms = self.now();
        let at_ms = self
            .time_of_window(&name, boot, result.seq)
            .unwrap_or(now_ms);
        let finite = |x: f64| x.is_finite().then_some(x);
        let id = self.change("storing a result", |change| {
            let values = params![
                result.session,
                device,
                boot,
                result.seq,
                result.half_cycle,
                at_ms,
                result.f_sw_hz,
                finite(result.i_crest_a),
                result.power_w.and_then(finite),
                finite(result.r_ohm),
                finite(result.l_h),
                finite(result.sigma_r_pct),
                finite(result.sigma_l_pct),
                result.pass,
                printable(&result.why),
                result.changed_lookup,
                result.iterations,
            ];
            let id = change.query_row(INSERT, values, |row| row.get(0))?;
            if let Some(state) = learner_state {
                put_state(change, "learned", device, now_ms, state)?;
            }
            Ok(id)
        })?;
        let is_informative = !result.pass || result.changed_lookup;
        if self.options().keep == SamplePolicy::Informative && !is_informative {
            self.drop_samples(&name, boot, result.seq, SampleDropReason::Uninformative);
        }
        Ok(id)
    }

    /// Time at which a window was stored; `None` if its day is gone or cannot be read.
    fn time_of_window(&self, device: &str, boot: u32, seq: u32) -> Option<i64> {
        let time = self.on_newest_day(|day| day.time(device, boot, seq));
        time.unwrap_or_else(|error| {
            tracing::warn!("{error}");
            None
        })
    }

    /// Returns results, newest first.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn results(&self, filter: &ResultFilter) -> Result<Vec<ResultRow>, StoreError> {
        rows(self.records(), filter).map_err(self.failed("listing results"))
    }

    /// Returns the stored state of a device's learner; `None` if there is none.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn learner_state(&self, device: DeviceId) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT state FROM learned WHERE device = ?1";
        let state = self.records().query_row(sql, [device], |row| row.get(0));
        let state = state.optional();
        state.map_err(self.failed("reading what was learned"))
    }

    /// Stores the alloys of pots on a device, in place of those before.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn keep_alloys(&mut self, device: DeviceId, state: &[u8]) -> Result<(), StoreError> {
        let at_ms = self.now();
        self.change("storing alloys", |change| {
            put_state(change, "alloys", device, at_ms, state)
        })
    }

    /// Returns the stored alloys of pots on a device; `None` if there are none.
    ///
    /// # Errors
    /// Errors of the database.
    pub fn alloys(&self, device: DeviceId) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT state FROM alloys WHERE device = ?1";
        let state = self.records().query_row(sql, [device], |row| row.get(0));
        state.optional().map_err(self.failed("reading alloys"))
    }
}
