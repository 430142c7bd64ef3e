//! History of a device: telemetry and results over minutes to months.

use ihd_model::{History, HistoryResults};
use ihd_store::ResultRow;

use super::{View, finite};
use crate::error::DaemonError;
use crate::history::{ColumnGrid, Columns};

impl View {
    /// Returns the history of a device from `from_ms` to `to_ms` (milliseconds since 1970, UTC) in at most `columns`
    /// (1 to 4000), including telemetry that is not written yet.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn history(
        &self,
        device: &str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> Result<History, DaemonError> {
        let grid = ColumnGrid::new(from_ms, to_ms, columns);
        // Taken before the store is read: telemetry written in between is in both, and counted once.
        let unwritten = self.telemetry.unwritten(device);
        self.read_device(device, move |reader, device| {
            let mut filled = Columns::new(grid);
            let within = (grid.from_s, grid.to_s);
            let mut add = |span| filled.add(&span);
            let written = reader.telemetry(device, within, grid.uses_minutes(), &mut add)?;
            let new = |at_s: i64| written.last_s.is_none_or(|last_s| at_s > last_s);
            for span in unwritten.iter().filter(|span| new(span.at_s)) {
                filled.add(span);
            }
            let span_ms = (grid.from_s * 1_000, to_ms.max(from_ms));
            let (of, rows) = reader.results_between(device, span_ms, columns.clamp(1, 4_000))?;
            Ok(filled.history((from_ms, to_ms), results(of, &rows)))
        })
        .await
    }
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
