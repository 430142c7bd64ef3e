//! Ages of the cells of a lookup.

use ihd_shared::lookup::grid::{
    CURRENTS, FREQUENCIES, current_coordinate, frequency_coordinate, split,
};
use ihd_store::{LastAccepted, ResultId};

/// Time of the last accepted result near each cell, in milliseconds since 1970, UTC; updated with new results.
#[derive(Clone, Debug, Default)]
pub struct CellAges {
    /// Newest result that was added.
    pub(super) last: ResultId,
    at_ms: [[Option<i64>; CURRENTS]; FREQUENCIES],
}

impl CellAges {
    /// Adds accepted results. A window of one frequency shows all currents up to its crest, in the rows below and
    /// above the frequency.
    pub(super) fn add(&mut self, accepted: &[LastAccepted]) {
        for result in accepted {
            self.last = self.last.max(result.last);
            let (row, weight) = split(frequency_coordinate(result.f_sw_hz), FREQUENCIES);
            let i_ma = (result.i_crest_a.clamp(0.0, 1e6) * 1e3) as u32;
            let (column, beyond) = split(current_coordinate(i_ma), CURRENTS);
            let columns = column + usize::from(beyond > 0);
            let rows = row..=row + usize::from(weight > 0);
            for row in self.at_ms.iter_mut().skip(*rows.start()).take(rows.count()) {
                for cell in row.iter_mut().take(columns + 1) {
                    *cell = (*cell).max(Some(result.at_ms));
                }
            }
        }
    }

    /// Returns the age of each cell in seconds at a time; `None` for one without a result.
    pub(super) fn at(&self, now_ms: i64) -> Vec<Vec<Option<f64>>> {
        let age = |at_ms: &Option<i64>| at_ms.map(|at_ms| (now_ms - at_ms).max(0) as f64 * 1e-3);
        let rows = self.at_ms.iter();
        rows.map(|row| row.iter().map(age).collect()).collect()
    }
}
