//! Minutes to months of a device.

use ihd_store::{Reader, ResultRow, StoreError};

use super::finite;
use crate::daemon::{Daemon, DaemonError};
use crate::history::{Columns, Grid};
use crate::model::{History, HistoryResults};

/// Longest that a window waits for the network, in milliseconds: the learner's queue is short.
const LONGEST_WAIT_MS: i64 = 600_000;

impl Daemon {
    /// What a device did from `from_ms` to `to_ms` (milliseconds since 1970, UTC) in at most so many columns (1 to
    /// 4000), with what is not written yet.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or what the store reports.
    pub async fn history(
        &self,
        device: &str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> Result<History, DaemonError> {
        let grid = Grid::new(from_ms, to_ms, columns);
        // Before the store is read: what is written meanwhile is in both, and counted once.
        let waiting = self.inner.seconds.of(device);
        self.read_of(device, move |reader, device| {
            let mut filled = Columns::new(grid);
            let within = (grid.from_s, grid.to_s);
            let mut add = |span| filled.add(&span);
            let done = reader.telemetry(device, within, grid.minutes(), &mut add)?;
            let new = |at_s: i64| done.last_s.is_none_or(|last_s| at_s > last_s);
            for span in waiting.iter().filter(|span| new(span.at_s)) {
                filled.add(span);
            }
            let span_ms = (grid.from_s * 1_000, to_ms.max(from_ms));
            let (of, mut rows) =
                reader.results_between(device, span_ms, columns.clamp(1, 4_000))?;
            at_their_windows(reader, device, span_ms, &mut rows)?;
            Ok(filled.history((from_ms, to_ms), results(of, &rows)))
        })
        .await
    }
}

/// Puts results where their windows came: the network may have had more to do than time. One whose window is not known
/// stays where it was stored.
fn at_their_windows(
    reader: &Reader,
    device: &str,
    (from_ms, to_ms): (i64, i64),
    rows: &mut [ResultRow],
) -> Result<(), StoreError> {
    let windows: Vec<_> = rows.iter().map(|row| (row.boot, row.seq)).collect();
    let days = (from_ms.saturating_sub(LONGEST_WAIT_MS), to_ms);
    let times = reader.times_of_windows(device, &windows, days)?;
    for (row, time) in rows.iter_mut().zip(times) {
        row.at_ms = time.unwrap_or(row.at_ms);
    }
    Ok(())
}

fn results(of: u64, rows: &[ResultRow]) -> HistoryResults {
    let list = |value: fn(&ResultRow) -> f64| rows.iter().map(|row| finite(value(row))).collect();
    HistoryResults {
        of,
        at_ms: rows.iter().map(|row| row.at_ms).collect(),
        r_ohm: list(|row| row.r_ohm),
        l_h: list(|row| row.l_h),
        sigma_r_pct: list(|row| row.sigma_r_pct),
        sigma_l_pct: list(|row| row.sigma_l_pct),
        pass: rows.iter().map(|row| row.pass).collect(),
    }
}
