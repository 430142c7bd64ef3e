//! Check of a store: integrity and contents.

use serde::Serialize;

use super::database::{self, IntegrityCheck};
use super::folder;
use super::windows::Day;
use super::{LookupState, StoreError, StoreReader, WindowFilter};

/// Faults that are listed one by one.
const MAX_LISTED: usize = 20;

/// Result of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CheckReport {
    /// `ok`, or the faults.
    pub integrity: String,
    /// Windows, with their samples or without.
    pub windows: u64,
    /// Windows with their samples.
    pub windows_with_samples: u64,
    /// Results.
    pub results: u64,
    /// Lookups, oldest first.
    pub lookups: Vec<CheckedLookup>,
    /// Files that were set aside as damaged.
    pub set_aside: Vec<String>,
}

/// A lookup of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CheckedLookup {
    /// The device's name.
    pub device: String,
    /// Its version.
    pub version: u32,
    /// State of the lookup on the device.
    pub state: LookupState,
}

impl CheckReport {
    /// Returns `true` if there is no fault.
    pub fn is_whole(&self) -> bool {
        self.integrity == "ok"
    }
}

impl StoreReader {
    /// Checks every page and index of every database, every reference between rows, and that every window
    /// and every lookup can be read.
    ///
    /// # Errors
    /// Errors of the databases other than damage.
    pub fn check(&self) -> Result<CheckReport, StoreError> {
        let mut wrong = Vec::new();
        note(
            &mut wrong,
            database::integrity_check(self.records(), self.path()),
        )?;
        let counted = self.count("SELECT count(*) FROM results");
        let results = or_wrong(&mut wrong, counted)?.unwrap_or(0);
        let strays = self.count("SELECT count(*) FROM pragma_foreign_key_check");
        if let Some(strays @ 1..) = or_wrong(&mut wrong, strays)? {
            wrong.push(format!(
                "ihd.db: {strays} rows refer to rows that are not there"
            ));
        }
        let lookups = or_wrong(&mut wrong, self.lookups())?.unwrap_or_default();
        for row in &lookups {
            if let Err(why) = ihd_shared::lookup::RlLookup::from_bytes(&row.blob) {
                wrong.push(format!("lookup {} of {}: {why}", row.version, row.device));
            }
        }
        let (mut windows, mut with_samples) = (0, 0);
        for file in folder::days(self.folder())? {
            let opened = or_wrong(&mut wrong, Day::open_to_read(file))?;
            let Some(day) = opened.flatten() else {
                continue;
            };
            note(
                &mut wrong,
                database::integrity_check(&day.connection, day.path()),
            )?;
            let rows = or_wrong(&mut wrong, day.rows(&WindowFilter::default()))?;
            for row in rows.unwrap_or_default() {
                windows += 1;
                if row.not_kept.is_none() {
                    let window = day.window(&row.device, row.boot, row.seq);
                    with_samples += u64::from(or_wrong(&mut wrong, window)?.is_some());
                }
            }
        }
        let lookups = lookups.into_iter().map(|row| CheckedLookup {
            device: row.device,
            version: row.version,
            state: row.state,
        });
        Ok(CheckReport {
            integrity: integrity(&wrong),
            windows,
            windows_with_samples: with_samples,
            results,
            lookups: lookups.collect(),
            set_aside: folder::set_aside_names(self.folder())?,
        })
    }
}

/// Adds the faults of SQLite's own check.
fn note(
    wrong: &mut Vec<String>,
    result: Result<IntegrityCheck, StoreError>,
) -> Result<(), StoreError> {
    match or_wrong(wrong, result)? {
        Some(IntegrityCheck::Corrupt(why)) => wrong.push(why),
        Some(IntegrityCheck::TimedOut) => wrong.push("not checked to the end".to_owned()),
        Some(IntegrityCheck::Ok) | None => {}
    }
    Ok(())
}

/// Turns damage into a fault of the report; other errors stay errors.
fn or_wrong<T>(
    wrong: &mut Vec<String>,
    result: Result<T, StoreError>,
) -> Result<Option<T>, StoreError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.is_damage() => {
            wrong.push(error.to_string());
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

fn integrity(wrong: &[String]) -> String {
    match wrong {
        [] => "ok".to_owned(),
        few if few.len() <= MAX_LISTED => few.join("; "),
        many => format!(
            "{}; and {} more",
            many[..MAX_LISTED].join("; "),
            many.len() - MAX_LISTED
        ),
    }
}
