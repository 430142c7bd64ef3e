//! Stored seconds and minutes as the columns of a display.

use ihd_model::{Envelope, History, HistoryResults};
use ihd_shared::wire::messages::{Pot, State};
use ihd_store::{Spread, TelemetrySpan};

use crate::tank;

/// Column width in seconds from which on minutes are read instead of seconds.
const MINUTE_S: i64 = 60;

/// Largest number of columns in a response.
pub const MAX_COLUMNS: usize = 4_000;

/// End of the year 9999 in milliseconds since 1970, UTC: later days have no file.
const LATEST_MS: i64 = 253_402_300_799_000;

/// Columns of an interval, aligned to whole seconds; from one minute of width on, to whole minutes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColumnGrid {
    /// Start of the first column, in seconds since 1970, UTC.
    pub from_s: i64,
    /// End of the interval, in seconds since 1970, UTC.
    pub to_s: i64,
    /// Width of a column, in seconds.
    pub step_s: i64,
}

impl ColumnGrid {
    /// Divides an interval in milliseconds since 1970, UTC, into at most `columns` columns. Each starts at a multiple of the
    /// width, so that an interval that moves with time keeps its columns.
    pub fn new(from_ms: i64, to_ms: i64, columns: usize) -> Self {
        let columns = columns.clamp(1, MAX_COLUMNS) as i64;
        let [from_ms, to_ms] = [from_ms, to_ms].map(|at_ms| at_ms.clamp(0, LATEST_MS));
        let from_s = from_ms / 1_000;
        let to_s = ((to_ms + 999) / 1_000).max(from_s + 1);
        // One column is reserved, because the first one starts before the interval.
        let least_s = match columns {
            1 => to_s - from_s + MINUTE_S,
            _ => (to_s - from_s + columns - 2) / (columns - 1),
        };
        let unit = if least_s >= MINUTE_S { MINUTE_S } else { 1 };
        let step_s = (least_s + unit - 1) / unit * unit;
        let multiple = if columns == 1 { unit } else { step_s };
        Self {
            from_s: from_s - from_s.rem_euclid(multiple),
            to_s,
            step_s,
        }
    }

    /// Returns `true` if the columns are read from minutes instead of seconds.
    pub fn uses_minutes(&self) -> bool {
        self.step_s >= MINUTE_S
    }

    fn column(&self, at_s: i64) -> Option<usize> {
        let inside = (self.from_s..self.to_s).contains(&at_s);
        inside.then(|| ((at_s - self.from_s) / self.step_s) as usize)
    }
}

/// Columns, filled while the store is read.
pub struct Columns {
    grid: ColumnGrid,
    spans: Vec<Option<TelemetrySpan>>,
}

impl Columns {
    /// Creates empty columns.
    pub fn new(grid: ColumnGrid) -> Self {
        let columns = (grid.to_s - grid.from_s + grid.step_s - 1) / grid.step_s;
        Self {
            grid,
            spans: vec![None; usize::try_from(columns).unwrap_or(0)],
        }
    }

    /// Adds a second or a minute, in the order of time.
    pub fn add(&mut self, span: &TelemetrySpan) {
        let column = self.grid.column(span.at_s);
        let column = column.and_then(|k| self.spans.get_mut(k));
        match column {
            Some(Some(sum)) => sum.merge(span),
            Some(empty) => *empty = Some(span.clone()),
            None => {}
        }
    }

    /// Returns the history from `from_ms` to `to_ms` with these results.
    pub fn history(self, (from_ms, to_ms): (i64, i64), results: HistoryResults) -> History {
        let mut history = History {
            from_ms,
            to_ms,
            step_ms: self.grid.step_s * 1_000,
            results,
            ..History::default()
        };
        for (k, span) in self.spans.iter().enumerate() {
            if let Some(span) = span {
                let at_s = self.grid.from_s + k as i64 * self.grid.step_s;
                push(&mut history, at_s * 1_000, span);
            }
        }
        history
    }
}

fn push(history: &mut History, at_ms: i64, span: &TelemetrySpan) {
    let half_cycles = u32::try_from(span.half_cycles()).unwrap_or(u32::MAX);
    history.at_ms.push(at_ms);
    history.half_cycles.push(half_cycles);
    envelope(&mut history.power_w, &span.power_mw, 1e-3);
    envelope(&mut history.i_crest_a, &span.i_crest_ma, 1e-3);
    envelope(&mut history.r_ohm, &span.r_uohm, 1e-6);
    envelope(&mut history.l_h, &span.l_ph, 1e-12);
    envelope(&mut history.f_sw_hz, &span.f_sw_hz, 1.0);
    let mean = |spread: &Spread, unit: f64| spread.min_mean_max().map(|[_, mean, _]| mean * unit);
    let (r_ohm, l_h) = (mean(&span.r_uohm, 1e-6), mean(&span.l_ph, 1e-12));
    let f_sw_hz = mean(&span.f_sw_hz, 1.0);
    let phase = r_ohm.zip(l_h).zip(f_sw_hz);
    history
        .phase_deg
        .push(phase.and_then(|((r, l), f)| tank::phase_deg(r, l, f)));
    history.resonance_hz.push(l_h.and_then(tank::resonance_hz));
    history.asked_w.push(span.asked_w);
    let state = State::ALL.iter().find(|s| **s as u8 == span.state);
    history
        .state
        .push(state.map_or_else(|| span.state.to_string(), |s| format!("{s:?}")));
    let pot = Pot::ALL.iter().find(|p| **p as u8 == span.pot);
    history
        .pot
        .push(pot.map_or_else(|| span.pot.to_string(), |p| format!("{p:?}")));
    history.fault.push(span.fault);
}

fn envelope(envelope: &mut Envelope, spread: &Spread, unit: f64) {
    let scaled = spread.min_mean_max().map(|values| values.map(|x| x * unit));
    envelope.min.push(scaled.map(|[min, _, _]| min));
    envelope.mean.push(scaled.map(|[_, mean, _]| mean));
    envelope.max.push(scaled.map(|[_, _, max]| max));
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOON_MS: i64 = 1_795_348_800_000;

    #[test]
    fn columns_are_as_many_as_asked_for_at_most_and_cover_all_that_was() {
        for (span_s, columns, step_s) in [
            (300, 600, 1),
            (300, 101, 3),
            (3_600, 601, 6),
            (86_400, 600, 180),
            (30 * 86_400, 600, 4_380),
            (86_400, 4_000, 22),
            (10, 1, 120),
        ] {
            let grid = ColumnGrid::new(NOON_MS, NOON_MS + span_s * 1_000, columns);
            assert_eq!(grid.step_s, step_s, "{span_s} s in {columns}");
            assert!(Columns::new(grid).spans.len() <= columns);
            assert!(grid.from_s <= NOON_MS / 1_000 && grid.to_s >= NOON_MS / 1_000 + span_s);
            assert_eq!(grid.uses_minutes(), step_s >= 60);
        }
        // Whatever is asked for.
        for from in [i64::MIN, -1, 0, 1, NOON_MS, NOON_MS + 1_234_567, i64::MAX] {
            for to in [i64::MIN, 0, NOON_MS - 1, NOON_MS + 7_777_777, i64::MAX] {
                for columns in [0, 1, 2, 3, 599, 4_000, usize::MAX] {
                    let grid = ColumnGrid::new(from, to, columns);
                    let spans = Columns::new(grid).spans.len();
                    assert!(grid.step_s > 0 && spans <= columns.clamp(1, 4_000));
                }
            }
        }
    }

    #[test]
    fn a_stretch_that_moves_keeps_its_columns() {
        let first = ColumnGrid::new(NOON_MS, NOON_MS + 3_600_000, 600);
        let later = ColumnGrid::new(NOON_MS + 61_000, NOON_MS + 3_661_000, 600);
        assert_eq!(first.step_s, later.step_s);
        assert_eq!((later.from_s - first.from_s) % first.step_s, 0);
    }

    #[test]
    fn a_column_holds_the_extremes_of_its_seconds_and_none_of_what_was_not() {
        let second = |at_s: i64, power_mw: i64, r_uohm: Option<i64>| TelemetrySpan {
            at_s,
            state: State::Heating as u8,
            pot: Pot::Ferromagnetic as u8,
            fault: if at_s == 1 { 12 } else { 0 },
            power_mw: Spread::from_value(power_mw),
            i_crest_ma: Spread::from_value(20_000),
            r_uohm: r_uohm.map(Spread::from_value).unwrap_or_default(),
            l_ph: r_uohm
                .map(|_| Spread::from_value(30_000_000))
                .unwrap_or_default(),
            f_sw_hz: r_uohm
                .map(|_| Spread::from_value(45_000))
                .unwrap_or_default(),
            ..TelemetrySpan::default()
        };
        let mut columns = Columns::new(ColumnGrid::new(0, 40_000, 5));
        columns.add(&second(0, 1_000_000, Some(2_000_000)));
        columns.add(&second(1, 3_000_000, Some(7_967_480)));
        columns.add(&second(35, 500, None));
        columns.add(&second(40, 1, None));
        let history = columns.history((0, 40_000), HistoryResults::default());
        assert_eq!(
            (history.step_ms, history.at_ms.as_slice()),
            (10_000, &[0, 30_000][..])
        );
        assert_eq!(history.power_w.min, [Some(1_000.0), Some(0.5)]);
        assert_eq!(history.power_w.mean[0], Some(2_000.0));
        assert_eq!(history.power_w.max[0], Some(3_000.0));
        assert_eq!(history.r_ohm.max[1], None);
        assert_eq!(
            (history.phase_deg[1], history.resonance_hz[1]),
            (None, None)
        );
        // X = 4.98374 ohm (tank.rs) and R = 4.98374 ohm in the mean.
        assert!((history.phase_deg[0].unwrap() - 45.0).abs() < 0.01);
        assert_eq!(history.fault, [12, 0]);
        assert_eq!(
            (history.state[0].as_str(), history.pot[1].as_str()),
            ("Heating", "Ferromagnetic")
        );
        let lists = [
            history.half_cycles.len(),
            history.i_crest_a.max.len(),
            history.f_sw_hz.mean.len(),
            history.asked_w.len(),
            history.resonance_hz.len(),
        ];
        assert_eq!(lists, [2; 5]);
    }
}
