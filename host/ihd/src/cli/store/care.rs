//! `ihd store check` and `backup`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use ihd_store::{DaySpace, Store, StoreError, StoreReader, bytes_a_day};
use serde_json::json;

use super::super::output;
use super::place::StorePlace;

/// Bytes of a window if there are too few to measure it (docs/daemon.md).
const BYTES_A_WINDOW: f64 = 30.8e3;

/// Error for a damaged store.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the store is damaged: {0}; docs/daemon.md says what to do")]
pub struct DamagedStore(String);

/// Check every page, index, window and lookup.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  ihd store check\n  ihd store check --json | jq .integrity\n  ihd store check --collect --config ihd.toml\n\n\
    Exit codes: 0 whole, or collected, 1 cannot be read, 2 wrong usage, 7 damaged"
)]
pub struct CheckArgs {
    /// Instead of the report, set damaged files aside and delete what is beyond the configuration's retention: days that are too old,
    /// and the samples of windows that newer ones need the room of. A daemon does that by itself, and keeps others from writing while
    /// it runs
    #[arg(long)]
    collect: bool,
}

/// Copy the store to a new folder, while the daemon writes to it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  ihd store backup /backup/ihd-store-today")]
pub struct BackupArgs {
    /// The new folder; it has this name when all of it is written, not before
    to: PathBuf,
}

impl CheckArgs {
    pub fn run(&self, place: &StorePlace, json: bool) -> Result<()> {
        if self.collect {
            return collect(place, json);
        }
        let checked = StoreReader::open(&place.folder).and_then(|reader| {
            let report = reader.check()?;
            Ok((report, reader.space()?))
        });
        let (report, space) = match checked {
            Err(error @ StoreError::Damaged { .. }) => return unreadable(&error, json),
            checked => checked?,
        };
        if json {
            let mut report = serde_json::to_value(&report)?;
            report["space"] = json!(space);
            output::json(&report)?;
        } else {
            say!("integrity   {}", report.integrity)?;
            say!(
                "windows     {}, {} with samples",
                report.windows,
                report.windows_with_samples
            )?;
            say!("results     {}", report.results)?;
            for lookup in &report.lookups {
                say!(
                    "lookup      {} version {}: {}",
                    lookup.device,
                    lookup.version,
                    lookup.state
                )?;
            }
            for name in &report.set_aside {
                say!("set aside   {name}")?;
            }
            say_space(&space, place.settings.retention.max_bytes)?;
        }
        if report.is_whole() {
            Ok(())
        } else {
            Err(DamagedStore(report.integrity).into())
        }
    }
}

/// Reports that `ihd.db` itself cannot be read.
fn unreadable(error: &StoreError, json: bool) -> Result<()> {
    if json {
        output::json(&json!({
            "integrity": error.to_string(), "windows": 0, "windows_with_samples": 0, "results": 0,
            "lookups": [], "set_aside": [],
        }))?;
    }
    Err(DamagedStore(error.to_string()).into())
}

/// Prints the room that windows take, and the time that it lasts.
fn say_space(days: &[DaySpace], max_bytes: u64) -> Result<()> {
    const GB: f64 = 1e9;
    let (bytes, may) = (
        days.iter().map(|day| day.bytes).sum::<u64>() as f64,
        max_bytes as f64,
    );
    say!("space       {:.2} of {:.2} GB", bytes / GB, may / GB)?;
    for day in days {
        let (gb, windows, whole) = (day.bytes as f64 / GB, day.windows, day.with_samples);
        say!(
            "            {}  {gb:.2} GB, {windows} windows, {whole} with samples",
            day.day
        )?;
    }
    let whole: u64 = days.iter().map(|day| day.with_samples).sum();
    let all: u64 = days.iter().map(|day| day.windows).sum();
    // With few windows, tables and rows without samples make up most of a day.
    let each = if whole < 1_000.max(all / 2) {
        BYTES_A_WINDOW
    } else {
        bytes / whole as f64
    };
    // Half-cycles at a mains frequency of 50 Hz.
    let a_second = 100.0 / f64::from(ihd_train::WINDOWS_EVERY);
    let a_day = bytes_a_day(each, a_second, 1.0);
    say!(
        "            a hob that heats all day makes {:.1} GB; {:.2} GB hold {:.1} h of heating, older windows are thinned, to {:.0} MB a day in the end",
        a_day / GB,
        may / GB,
        24.0 * may / a_day,
        1_440.0 * each / 1e6
    )
}

/// Deletes what is beyond the retention.
fn collect(place: &StorePlace, json: bool) -> Result<()> {
    // Fails if there is no store: cleaning does not create one.
    drop(StoreReader::open(&place.folder)?);
    let opened = Store::open(&place.folder, &place.settings)?;
    let mut store = opened.store;
    let collected = store.collect_garbage()?;
    if json {
        return output::json(&json!({ "damage": opened.damage, "collected": collected }));
    }
    for damage in &opened.damage {
        say!("damaged   {}: {}", damage.from.display(), damage.why)?;
        say!("set aside {}", damage.to.display())?;
    }
    for path in &collected.deleted {
        say!("deleted   {}", path.display())?;
    }
    say!(
        "freed     {} bytes in {} files; samples of {} windows that tell nothing, of {} thinned; {} old rows",
        collected.bytes,
        collected.deleted.len(),
        collected.samples_dropped,
        collected.thinned,
        collected.rows
    )?;
    say!("left      {} bytes of windows", collected.bytes_left)
}

impl BackupArgs {
    pub fn run(&self, place: &StorePlace, json: bool) -> Result<()> {
        if self.to.as_os_str().is_empty() {
            bail!("TO names no folder");
        }
        ihd_store::backup(&place.folder, &self.to)?;
        if json {
            return output::json(&json!({ "from": place.folder, "to": self.to }));
        }
        say!(
            "backed up {} to {}",
            place.folder.display(),
            self.to.display()
        )
    }
}
