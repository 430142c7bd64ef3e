//! Window that is to be sent to the fleet.

use rusqlite::Row;

use super::windows::Day;

/// A window to be sent: the fleet has acknowledged neither it nor its result.
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
    /// Time at which it was stored, in milliseconds since 1970, UTC.
    pub at_ms: i64,
}

impl Day {
    /// Builds a due window from a row of device, boot, number and time.
    pub(crate) fn due_window(&self, row: &Row<'_>) -> rusqlite::Result<DueWindow> {
        Ok(DueWindow {
            day: self.file.day.clone(),
            device: row.get(0)?,
            boot: row.get(1)?,
            seq: row.get(2)?,
            at_ms: row.get(3)?,
        })
    }
}
