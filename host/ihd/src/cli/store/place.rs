//! Where the store is, and how it keeps: from the configuration, or from the command line.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use ihd_store::{Retention, Settings};
use serde::Deserialize;

use super::super::usage::Usage;

/// The configuration that is read where there is one and none is named.
const CONFIG: &str = "ihd.toml";

/// The folder without a configuration.
const STORE: &str = "ihd-store";

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

/// What of the configuration matters here.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Config {
    store: Option<PathBuf>,
    keep: Keeping,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Keeping {
    windows: ihd_store::Keep,
    max_age_days: Option<u32>,
    max_bytes: Option<u64>,
}

impl PlaceArgs {
    /// Reads the configuration, where there is one.
    ///
    /// # Errors
    /// When the one that was named cannot be read, or is none.
    pub fn place(&self) -> Result<Place> {
        let config = match &self.config {
            Some(path) => read(path)?,
            None if Path::new(CONFIG).is_file() => read(Path::new(CONFIG))?,
            None => Config::default(),
        };
        let folder = self.store.clone().or(config.store);
        let keep = config.keep;
        let usual = Retention::default().max_bytes;
        Ok(Place {
            folder: folder.unwrap_or_else(|| STORE.into()),
            settings: Settings {
                retention: Retention {
                    max_age_days: keep.max_age_days,
                    max_bytes: keep.max_bytes.unwrap_or(usual),
                },
                keep: keep.windows,
            },
        })
    }
}

fn read(path: &Path) -> Result<Config> {
    let name = path.display();
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the configuration {name}"))?;
    toml::from_str(&text)
        .map_err(|error| Usage(format!("the configuration {name}: {error}")).into())
}

/// A day (UTC) or a time as milliseconds since 1970: `2026-11-22` or `2026-11-22T08:30:00Z`.
///
/// # Errors
/// What it should look like.
pub fn time(text: &str) -> Result<i64, String> {
    ihd_store::clock::parse(text)
        .ok_or_else(|| "a day (2026-11-22) or a time (2026-11-22T08:30:00Z)".to_owned())
}
