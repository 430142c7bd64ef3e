//! Network of the trainer on the command line: a file, a backend, or both.

use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use clap::Args;
use ihd_pinn::{Backend, PinnConfig};

/// Network of the trainer.
#[derive(Debug, Args)]
pub struct NetworkArgs {
    /// Network: a TOML file with its settings over the preset that it names (what it leaves out keeps the preset's value), and
    /// backend=fused (own code) or backend=ndarray (burn); both by giving it again.
    #[arg(long, value_name = "FILE|backend=NAME")]
    network: Vec<NetworkChoice>,
}

/// Value of `--network`.
#[derive(Clone, Debug)]
enum NetworkChoice {
    File(PathBuf),
    Backend(Backend),
}

impl FromStr for NetworkChoice {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        Ok(match text.strip_prefix("backend=") {
            Some(name) => Self::Backend(name.parse()?),
            None => Self::File(text.into()),
        })
    }
}

impl NetworkArgs {
    /// Last file.
    fn file(&self) -> Option<&Path> {
        self.network.iter().rev().find_map(|choice| match choice {
            NetworkChoice::File(file) => Some(file.as_path()),
            NetworkChoice::Backend(_) => None,
        })
    }

    /// Last backend.
    fn backend(&self) -> Option<Backend> {
        self.network.iter().rev().find_map(|choice| match choice {
            NetworkChoice::Backend(backend) => Some(*backend),
            NetworkChoice::File(_) => None,
        })
    }

    /// Configuration of the network.
    ///
    /// # Errors
    /// A file that cannot be read, or an invalid value.
    pub fn config(&self) -> Result<PinnConfig> {
        let mut config = match self.file() {
            None => PinnConfig::default(),
            Some(path) => {
                let text = fs::read_to_string(path)
                    .with_context(|| format!("cannot read {}", path.display()))?;
                PinnConfig::from_toml(&text)
                    .with_context(|| format!("{} is no configuration", path.display()))?
            }
        };
        if let Some(backend) = self.backend() {
            config.backend = backend;
        }
        config.validate()?;
        Ok(config)
    }

    /// Settings in the form of a configuration; `None` if none are given.
    ///
    /// # Errors
    /// Any error of [`NetworkArgs::config`].
    #[cfg(feature = "daemon")]
    pub fn table(&self) -> Result<Option<toml::Table>> {
        if self.network.is_empty() {
            return Ok(None);
        }
        self.config()?;
        let text = self.file().map_or(Ok(String::new()), fs::read_to_string)?;
        let mut table: toml::Table = text.parse()?;
        if let Some(backend) = self.backend() {
            table.insert("backend".to_owned(), backend.to_string().into());
        }
        Ok(Some(table))
    }
}
