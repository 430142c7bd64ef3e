//! Folder and options of the store, from the configuration or the command line.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd_store::{StoreError, StoreOptions, StoreReader};

use super::super::configured;
use super::super::global::Global;

#[derive(Debug, Args)]
pub struct PlaceArgs {
    /// Folder of the store; default: the configuration's, else ihd-store
    #[arg(long, value_name = "DIR", global = true)]
    store: Option<PathBuf>,
}

/// Folder and options of a store.
pub struct StorePlace {
    pub folder: PathBuf,
    pub settings: StoreOptions,
}

impl StorePlace {
    /// Opens the store for reading.
    ///
    /// # Errors
    /// Errors of [`StoreReader::open`]; names the runs of `ihd trainer` if the folder holds these alone.
    pub fn read(&self) -> Result<StoreReader> {
        StoreReader::open(&self.folder).map_err(|why| {
            let run = self.folder.join("run-001");
            let only_runs = matches!(why, StoreError::NoStore { .. }) && run.is_dir();
            let context = format!(
                "{} holds runs of `ihd trainer`, which are files (`ihd inspect {}`); a store is made by `ihd trainer --daemon`",
                self.folder.display(),
                run.join("session.mcap").display()
            );
            let why = anyhow::Error::from(why);
            if only_runs { why.context(context) } else { why }
        })
    }

    /// Opens the store to read what it has of a device, or of all.
    ///
    /// # Errors
    /// Errors of [`StorePlace::read`]; a device that the store does not have.
    pub fn read_of(&self, device: Option<&str>) -> Result<StoreReader> {
        let reader = self.read()?;
        if let Some(device) = device {
            let names: Vec<_> = reader.devices()?.into_iter().map(|d| d.name).collect();
            ensure_usage!(
                names.iter().any(|name| name == device),
                "{} has no device `{device}`; it has: {}",
                self.folder.display(),
                names.join(", ")
            );
        }
        Ok(reader)
    }
}

impl PlaceArgs {
    /// Reads the configuration, if there is one.
    ///
    /// # Errors
    /// If a named configuration cannot be read or is invalid.
    pub fn place(&self, global: &Global) -> Result<StorePlace> {
        let config = configured::config(global.config.as_deref())?;
        Ok(StorePlace {
            settings: config.store_settings(),
            folder: self.store.clone().unwrap_or(config.store),
        })
    }
}

/// Parses a day (UTC) or a time, in milliseconds since 1970: `2026-11-22` or `2026-11-22T08:30:00Z`.
///
/// # Errors
/// A description of the syntax.
pub fn time(text: &str) -> Result<i64, String> {
    ihd_store::clock::parse(text)
        .ok_or_else(|| "a day (2026-11-22) or a time (2026-11-22T08:30:00Z)".to_owned())
}
