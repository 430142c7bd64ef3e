//! Where the store is, and how it keeps: from the configuration, or from the command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd_store::Settings;

use super::super::configured;

#[derive(Debug, Args)]
pub struct PlaceArgs {
    /// The daemon's configuration; ihd.toml in this folder where there is one
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// The store's folder; the configuration's where it is not given, else ihd-store
    #[arg(long, value_name = "DIR", global = true)]
    store: Option<PathBuf>,
}

/// A store's folder, and how it keeps.
pub struct Place {
    pub folder: PathBuf,
    pub settings: Settings,
}

impl PlaceArgs {
    /// Reads the configuration, where there is one.
    ///
    /// # Errors
    /// When the one that was named cannot be read, or is none.
    pub fn place(&self) -> Result<Place> {
        let config = configured::config(self.config.as_deref())?;
        Ok(Place {
            settings: config.store_settings(),
            folder: self.store.clone().unwrap_or(config.store),
        })
    }
}

/// A day (UTC) or a time as milliseconds since 1970: `2026-11-22` or `2026-11-22T08:30:00Z`.
///
/// # Errors
/// What it should look like.
pub fn time(text: &str) -> Result<i64, String> {
    ihd_store::clock::parse(text)
        .ok_or_else(|| "a day (2026-11-22) or a time (2026-11-22T08:30:00Z)".to_owned())
}
