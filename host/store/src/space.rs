//! Disk space of windows.

use serde::Serialize;

use super::windows::Day;
use super::{StoreError, StoreReader, folder};

/// Disk space of a day's windows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DaySpace {
    /// `YYYY-MM-DD`, in UTC.
    pub day: String,
    /// Bytes on disk.
    pub bytes: u64,
    /// Windows, with samples or without.
    pub windows: u64,
    /// Windows with samples.
    pub with_samples: u64,
}

/// Returns the bytes of a hob's windows in a day; `duty` is the share of the day in which it heats.
pub fn bytes_a_day(bytes_a_window: f64, windows_a_second: f64, duty: f64) -> f64 {
    bytes_a_window * windows_a_second * duty * 86_400.0
}

impl StoreReader {
    /// Returns the disk space of windows, oldest day first. Damaged days are left out.
    ///
    /// # Errors
    /// Errors of the databases or the operating system.
    pub fn space(&self) -> Result<Vec<DaySpace>, StoreError> {
        let mut days = Vec::new();
        for file in folder::days(self.folder())? {
            let Day { file, connection } = match Day::open_to_read(file) {
                Ok(Some(day)) => day,
                Ok(None) => continue,
                Err(error) if error.is_damage() => continue,
                Err(error) => return Err(error),
            };
            let count = |which: &str| -> Result<u64, StoreError> {
                let sql = format!("SELECT count(*) FROM windows {which}");
                let count = connection.query_row(&sql, [], |row| row.get::<_, i64>(0));
                let count = count.map_err(StoreError::database(&file.path, "counting"))?;
                Ok(u64::try_from(count).unwrap_or(0))
            };
            days.push(DaySpace {
                bytes: folder::size(&file.path),
                windows: count("")?,
                with_samples: count("WHERE not_kept IS NULL")?,
                day: file.day,
            });
        }
        Ok(days)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hob_that_heats_all_day_makes_thirteen_gigabytes() {
        // 30.8 kB, one in 20 half-cycles of a mains of 50 Hz: 30.8e3 x 5 x 86400 = 13.3e9.
        let all_day = bytes_a_day(30.8e3, 5.0, 1.0);
        assert!((13.2e9..13.4e9).contains(&all_day), "{all_day}");
        assert_eq!(bytes_a_day(30.8e3, 5.0, 0.25), all_day / 4.0);
    }
}
