//! `ihd store check`, `gc` and `backup`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use ihd_store::{Reader, Store, StoreError};
use serde_json::json;

use super::super::output;
use super::place::Place;

/// A check found the store damaged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the store is damaged: {0}; docs/store.md says what to do")]
pub struct DamagedStore(String);

/// Check every page, index, window and lookup.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  ihd store check\n  ihd store check --json | jq .integrity\n\n\
    Exit codes: 0 whole, 1 cannot be read, 2 wrong usage, 7 damaged"
)]
pub struct CheckArgs {
    /// Print the report as a JSON object
    #[arg(long)]
    json: bool,
}

/// Delete what is beyond the configuration's retention: whole days of windows, today's never.
///
/// A daemon does that by itself, and keeps others from writing while it runs.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  ihd store gc\n  ihd store gc --config ihd.toml --json")]
pub struct GcArgs {
    /// Print what was deleted as a JSON object
    #[arg(long)]
    json: bool,
}

/// Copy the store to a new folder, while the daemon writes to it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  ihd store backup /backup/ihd-store-today")]
pub struct BackupArgs {
    /// The new folder; it has this name when all of it is written, not before
    to: PathBuf,
    /// Print what was done as a JSON object
    #[arg(long)]
    json: bool,
}

impl CheckArgs {
    pub fn run(&self, place: &Place) -> Result<()> {
        let report = match Reader::open(&place.folder).and_then(|reader| reader.check()) {
            Err(error @ StoreError::Damaged { .. }) => return self.unreadable(&error),
            report => report?,
        };
        if self.json {
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
        }
        if report.is_whole() {
            Ok(())
        } else {
            Err(DamagedStore(report.integrity).into())
        }
    }

    /// `ihd.db` itself is none.
    fn unreadable(&self, error: &StoreError) -> Result<()> {
        if self.json {
            output::json(&json!({
                "integrity": error.to_string(), "windows": 0, "windows_with_samples": 0, "results": 0,
                "lookups": [], "set_aside": [],
            }))?;
        }
        Err(DamagedStore(error.to_string()).into())
    }
}

impl GcArgs {
    pub fn run(&self, place: &Place) -> Result<()> {
        // A store is not made by cleaning it.
        drop(Reader::open(&place.folder)?);
        let opened = Store::open(&place.folder, &place.settings)?;
        let mut store = opened.store;
        let collected = store.collect_garbage()?;
        if self.json {
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
            "freed     {} bytes in {} files; samples of {} windows that tell nothing; {} old rows",
            collected.bytes,
            collected.deleted.len(),
            collected.samples_dropped,
            collected.rows
        )?;
        say!("left      {} bytes of windows", collected.bytes_left)?;
        if collected.today_is_too_large {
            say!("today's windows alone take all that windows may: their samples are not kept")?;
        }
        Ok(())
    }
}

impl BackupArgs {
    pub fn run(&self, place: &Place) -> Result<()> {
        if self.to.as_os_str().is_empty() {
            bail!("TO names no folder");
        }
        ihd_store::backup(&place.folder, &self.to)?;
        if self.json {
            return output::json(&json!({ "from": place.folder, "to": self.to }));
        }
        say!(
            "backed up {} to {}",
            place.folder.display(),
            self.to.display()
        )
    }
}
