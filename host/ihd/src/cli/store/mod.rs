//! `ihd store`: contents of the daemon's store.

mod care;
mod export;
mod listing;
mod place;

use anyhow::Result;
use clap::{Args, Subcommand};

use super::global::Global;
pub use care::DamagedStore;
use place::PlaceArgs;

/// Query the daemon's store: results, windows, lookups; export, check, back up, collect.
///
/// All but `check --collect` work beside a running daemon. docs/daemon.md has the tables, and queries in SQL, Python and MATLAB.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd store ls --device bench --limit 20\n  \
    ihd store ls 4711\n  \
    ihd store check --json\n  \
    ihd store export --format mcap --device bench --since 2026-11-22 --out windows\n  \
    ihd store export --results --format csv --out results.csv\n  \
    ihd store backup /backup/ihd-store-today\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 7 `check` found damage")]
pub struct StoreArgs {
    #[command(flatten)]
    place: PlaceArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Ls(listing::LsArgs),
    Check(care::CheckArgs),
    Export(export::ExportArgs),
    Backup(care::BackupArgs),
}

impl StoreArgs {
    /// Runs the command.
    ///
    /// # Errors
    /// [`ihd_store::StoreError`]; [`DamagedStore`] after the report of a check.
    pub fn run(&self, global: &Global) -> Result<()> {
        let place = self.place.place(global)?;
        match &self.command {
            Command::Ls(args) => args.run(&place, global.json),
            Command::Check(args) => args.run(&place, global.json),
            Command::Export(args) => args.run(&place, global.json),
            Command::Backup(args) => args.run(&place, global.json),
        }
    }
}
