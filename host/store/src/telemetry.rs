//! Telemetry by the second: least, mean and largest over the half-cycles of each device.

use std::collections::BTreeSet;

use rusqlite::{Connection, OptionalExtension, Row, Statement, params};

use super::text::printable;
use super::windows::Day;
use super::{Store, StoreError, StoreReader, clock};

/// Seconds of a row that summarises others.
const MINUTE_S: i64 = 60;

/// Least, mean and largest of a quantity, in a unit in which it is a whole number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    n: u64,
    min: i64,
    max: i64,
    sum: f64,
}

impl Spread {
    /// Creates the spread of one value.
    pub fn from_value(x: i64) -> Self {
        Self {
            n: 1,
            min: x,
            max: x,
            sum: x as f64,
        }
    }

    /// Returns the number of values.
    pub fn count(&self) -> u64 {
        self.n
    }

    /// Adds another spread.
    pub fn merge(&mut self, other: &Self) {
        if other.n == 0 {
            return;
        }
        if self.n == 0 {
            *self = *other;
            return;
        }
        self.n += other.n;
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.sum += other.sum;
    }

    /// Returns least, mean and largest; `None` without values.
    pub fn min_mean_max(&self) -> Option<[f64; 3]> {
        let mean = self.sum / self.n as f64;
        (self.n > 0).then_some([self.min as f64, mean, self.max as f64])
    }

    /// Returns its three columns of a row.
    fn columns(&self) -> [Option<i64>; 3] {
        let mean = (self.sum / self.n as f64).round() as i64;
        [self.min, mean, self.max].map(|x| (self.n > 0).then_some(x))
    }

    /// Reads it from three columns of a row.
    fn read(row: &Row<'_>, first: usize, n: u64) -> rusqlite::Result<Self> {
        if n == 0 {
            return Ok(Self::default());
        }
        let column = |k: usize| row.get::<_, Option<i64>>(first + k);
        let [min, mean, max] = [column(0)?, column(1)?, column(2)?].map(Option::unwrap_or_default);
        let sum = mean as f64 * n as f64;
        Ok(Self { n, min, max, sum })
    }
}

/// Telemetry of a device over some seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TelemetrySpan {
    /// Beginning in seconds since 1970, UTC.
    pub at_s: i64,
    /// Requested power at its end, in watt.
    pub asked_w: u16,
    /// Number of the controller's state at its end (`ihd_shared::wire::messages::State`).
    pub state: u8,
    /// Number of the pot's state at its end (`ihd_shared::wire::messages::Pot`).
    pub pot: u8,
    /// Number of the last fault in it; 0 if none.
    pub fault: u16,
    /// Power of each half-cycle, in milliwatt; its count is the number of half-cycles.
    pub power_mw: Spread,
    /// Amplitude of the current's fundamental at the crest, in milliampere, of each half-cycle.
    pub i_crest_ma: Spread,
    /// R at the crest in microohm, over the half-cycles in which the device heated.
    pub r_uohm: Spread,
    /// L at the crest in picohenry, over the half-cycles in which the device heated.
    pub l_ph: Spread,
    /// Switching frequency in hertz, over the half-cycles in which the device heated.
    pub f_sw_hz: Spread,
}

impl TelemetrySpan {
    /// Returns the number of half-cycles.
    pub fn half_cycles(&self) -> u64 {
        self.power_mw.count()
    }

    /// Adds a later span, or one within it.
    pub fn merge(&mut self, later: &Self) {
        self.asked_w = later.asked_w;
        self.state = later.state;
        self.pot = later.pot;
        if later.fault != 0 {
            self.fault = later.fault;
        }
        self.power_mw.merge(&later.power_mw);
        self.i_crest_ma.merge(&later.i_crest_ma);
        self.r_uohm.merge(&later.r_uohm);
        self.l_ph.merge(&later.l_ph);
        self.f_sw_hz.merge(&later.f_sw_hz);
    }
}

/// Telemetry of a device in one second, to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct TelemetrySecond {
    /// The device's name.
    pub device: String,
    /// Its telemetry.
    pub span: TelemetrySpan,
}

const INSERT: &str = "
INSERT INTO telemetry (device, span_s, at_s, half_cycles, heating, asked_w, state, pot, fault,
    power_min_mw, power_mean_mw, power_max_mw, i_crest_min_ma, i_crest_mean_ma, i_crest_max_ma,
    r_min_uohm, r_mean_uohm, r_max_uohm, l_min_ph, l_mean_ph, l_max_ph, f_sw_min_hz, f_sw_mean_hz, f_sw_max_hz)
VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22,
    ?23, ?24)
ON CONFLICT (device, span_s, at_s) DO UPDATE SET half_cycles = excluded.half_cycles,
    heating = excluded.heating, asked_w = excluded.asked_w, state = excluded.state, pot = excluded.pot,
    fault = excluded.fault, power_min_mw = excluded.power_min_mw, power_mean_mw = excluded.power_mean_mw,
    power_max_mw = excluded.power_max_mw, i_crest_min_ma = excluded.i_crest_min_ma,
    i_crest_mean_ma = excluded.i_crest_mean_ma, i_crest_max_ma = excluded.i_crest_max_ma,
    r_min_uohm = excluded.r_min_uohm, r_mean_uohm = excluded.r_mean_uohm, r_max_uohm = excluded.r_max_uohm,
    l_min_ph = excluded.l_min_ph, l_mean_ph = excluded.l_mean_ph, l_max_ph = excluded.l_max_ph,
    f_sw_min_hz = excluded.f_sw_min_hz, f_sw_mean_hz = excluded.f_sw_mean_hz,
    f_sw_max_hz = excluded.f_sw_max_hz
WHERE excluded.half_cycles >= telemetry.half_cycles";

const SELECT: &str = "
SELECT at_s, half_cycles, heating, asked_w, state, pot, fault, power_min_mw, power_mean_mw, power_max_mw,
    i_crest_min_ma, i_crest_mean_ma, i_crest_max_ma, r_min_uohm, r_mean_uohm, r_max_uohm, l_min_ph, l_mean_ph,
    l_max_ph, f_sw_min_hz, f_sw_mean_hz, f_sw_max_hz
FROM telemetry WHERE device = ?1 AND span_s = ?2 AND at_s >= ?3 AND at_s < ?4 ORDER BY at_s";

fn insert(
    statement: &mut Statement<'_>,
    device: &str,
    span_s: i64,
    span: &TelemetrySpan,
) -> rusqlite::Result<()> {
    let power = span.power_mw.columns();
    let current = span.i_crest_ma.columns();
    let (r, l) = (span.r_uohm.columns(), span.l_ph.columns());
    let f_sw = span.f_sw_hz.columns();
    statement.execute(params![
        device,
        span_s,
        span.at_s,
        span.half_cycles() as i64,
        span.r_uohm.count() as i64,
        span.asked_w,
        span.state,
        span.pot,
        span.fault,
        power[0],
        power[1],
        power[2],
        current[0],
        current[1],
        current[2],
        r[0],
        r[1],
        r[2],
        l[0],
        l[1],
        l[2],
        f_sw[0],
        f_sw[1],
        f_sw[2],
    ])?;
    Ok(())
}

fn read(row: &Row<'_>) -> rusqlite::Result<TelemetrySpan> {
    let count = |k: usize| row.get::<_, i64>(k).map(|n| u64::try_from(n).unwrap_or(0));
    let (half_cycles, heating) = (count(1)?, count(2)?);
    Ok(TelemetrySpan {
        at_s: row.get(0)?,
        asked_w: row.get(3)?,
        state: row.get(4)?,
        pot: row.get(5)?,
        fault: row.get(6)?,
        power_mw: Spread::read(row, 7, half_cycles)?,
        i_crest_ma: Spread::read(row, 10, half_cycles)?,
        r_uohm: Spread::read(row, 13, heating)?,
        l_ph: Spread::read(row, 16, heating)?,
        f_sw_hz: Spread::read(row, 19, heating)?,
    })
}

/// Calls a function for the rows of one length in a stretch of time, in order.
fn each(
    connection: &Connection,
    (device, span_s): (&str, i64),
    (from_s, to_s): (i64, i64),
    take: &mut dyn FnMut(TelemetrySpan),
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare(SELECT)?;
    let mut rows = statement.query(params![device, span_s, from_s, to_s])?;
    while let Some(row) = rows.next()? {
        take(read(row)?);
    }
    Ok(())
}

/// Summarises a minute from its seconds; `None` if it has none.
fn sum_up(
    connection: &Connection,
    device: &str,
    minute_s: i64,
) -> rusqlite::Result<Option<TelemetrySpan>> {
    let mut sum: Option<TelemetrySpan> = None;
    let within = (minute_s, minute_s + MINUTE_S);
    each(
        connection,
        (device, 1),
        within,
        &mut |second| match &mut sum {
            Some(sum) => sum.merge(&second),
            None => sum = Some(second),
        },
    )?;
    Ok(sum.map(|sum| TelemetrySpan {
        at_s: minute_s,
        ..sum
    }))
}

fn keep(connection: &Connection, seconds: &[&TelemetrySecond]) -> rusqlite::Result<()> {
    let change = connection.unchecked_transaction()?;
    {
        let mut statement = change.prepare(INSERT)?;
        let mut minutes = BTreeSet::new();
        for TelemetrySecond { device, span } in seconds {
            let device = printable(device);
            insert(&mut statement, &device, 1, span)?;
            minutes.insert((device, span.at_s - span.at_s.rem_euclid(MINUTE_S)));
        }
        for (device, minute_s) in &minutes {
            if let Some(minute) = sum_up(&change, device, *minute_s)? {
                insert(&mut statement, device, MINUTE_S, &minute)?;
            }
        }
    }
    change.commit()
}

impl Day {
    fn keep_telemetry(&self, seconds: &[&TelemetrySecond]) -> Result<(), StoreError> {
        let failed = StoreError::database(self.path(), "storing telemetry");
        keep(&self.connection, seconds).map_err(failed)
    }

    /// Returns `true` if the day has this table; days of earlier versions lack some.
    pub(crate) fn has_table(&self, table: &str) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE type = 'table' AND name = ?1)";
        let exists = self.connection.query_row(sql, [table], |row| row.get(0));
        exists.map_err(StoreError::database(self.path(), "looking for a table"))
    }
}

impl Store {
    /// Stores seconds of telemetry, also if the limits leave no room for windows, in one transaction a day. Returns the
    /// number stored: those of a day that is neither today nor the last one before are dropped.
    ///
    /// # Errors
    /// Errors of the database or the operating system.
    pub fn keep_telemetry(&mut self, seconds: &[TelemetrySecond]) -> Result<usize, StoreError> {
        match self.keep_seconds(seconds) {
            Err(error) if error.is_damage() => {
                self.set_today_aside(&error)?;
                self.keep_seconds(seconds)
            }
            result => result,
        }
    }

    fn keep_seconds(&mut self, seconds: &[TelemetrySecond]) -> Result<usize, StoreError> {
        let today = clock::day(self.now());
        self.turn_to(&today)?;
        let mut stored = 0;
        for day in self.days.each() {
            let of_day = |second: &&TelemetrySecond| {
                let at_ms = second.span.at_s.saturating_mul(1_000);
                clock::day(at_ms) == day.file.day
            };
            let its: Vec<_> = seconds.iter().filter(of_day).collect();
            if !its.is_empty() {
                day.keep_telemetry(&its)?;
                stored += its.len();
            }
        }
        Ok(stored)
    }
}

/// Extent of the telemetry in a stretch of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TelemetryRead {
    /// Last stored second of the device in those days; `None` if there is none.
    pub last_s: Option<i64>,
}

impl StoreReader {
    /// Passes a device's telemetry from `from_s` until before `to_s` (seconds since 1970, UTC) in rows of a second, or
    /// of a minute if `minutes`, oldest first.
    ///
    /// # Errors
    /// Errors of the databases.
    pub fn telemetry(
        &self,
        device: &str,
        (from_s, to_s): (i64, i64),
        minutes: bool,
        take: &mut dyn FnMut(TelemetrySpan),
    ) -> Result<TelemetryRead, StoreError> {
        let span_s = if minutes { MINUTE_S } else { 1 };
        let mut done = TelemetryRead::default();
        for day in self.days_between(from_s.saturating_mul(1_000), to_s.saturating_mul(1_000))? {
            if !day.has_table("telemetry")? {
                continue;
            }
            let failed = StoreError::database(day.path(), "reading telemetry");
            let mut read = || -> rusqlite::Result<Option<i64>> {
                // Both queries see the same state.
                let view = day.connection.unchecked_transaction()?;
                let last = view
                    .query_row(
                        "SELECT max(at_s) FROM telemetry WHERE device = ?1 AND span_s = 1",
                        [device],
                        |row| row.get(0),
                    )
                    .optional()?;
                each(&view, (device, span_s), (from_s, to_s), take)?;
                Ok(last.flatten())
            };
            done.last_s = done.last_s.max(read().map_err(failed)?);
        }
        Ok(done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minutes_are_what_their_half_cycles_are() {
        let mut all = Spread::default();
        assert_eq!(all.min_mean_max(), None);
        for x in [3, -5, 10] {
            all.merge(&Spread::from_value(x));
        }
        let mut two = Spread::from_value(100);
        two.merge(&Spread::from_value(200));
        all.merge(&two);
        // (3 - 5 + 10 + 100 + 200) / 5.
        assert_eq!(all.min_mean_max(), Some([-5.0, 61.6, 200.0]));
        all.merge(&Spread::default());
        assert_eq!(all.count(), 5);
    }
}
