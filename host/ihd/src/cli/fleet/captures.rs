//! `ihd fleet captures`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd_fleet::captures;

use super::{AccessArgs, ago};
use crate::report::table::Table;

/// Captures in the fleet: list them, put one there, get one
#[derive(Debug, Args)]
#[command(
    after_help = "Example: ihd fleet captures get lab-1/bench-2026-11-23T08-00-00Z.mcap bench.mcap"
)]
pub struct CapturesArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List the captures
    Ls {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Upload a file
    Put {
        /// The file
        file: PathBuf,
        /// Its name in the fleet; default: the file's own
        #[arg(long)]
        name: Option<String>,
    },
    /// Get one
    Get {
        /// Its name, as `ls` shows it
        name: String,
        /// File to write; it must not exist
        file: PathBuf,
    },
}

impl CapturesArgs {
    pub(super) fn run(&self, access: &AccessArgs) -> Result<()> {
        match &self.command {
            Command::Ls { json } => {
                let captures =
                    access.with(async |_, context| Ok(captures::list(&context).await?))?;
                if *json {
                    return say!("{}", serde_json::to_string_pretty(&captures)?);
                }
                let mut table = Table::new(&["capture", "bytes", "ago"]);
                for capture in &captures {
                    let at = capture.at_s.map_or(String::new(), |at_s| ago(1_000 * at_s));
                    table.row([capture.name.clone(), capture.bytes.to_string(), at]);
                }
                say!("{}", table.render().trim_end())
            }
            Command::Put { file, name } => {
                let own = file.file_name().map(|n| n.to_string_lossy().into_owned());
                let name = name.clone().or(own);
                let name = name.with_context(|| format!("{} names no file", file.display()))?;
                let bytes = access
                    .with(async |_, context| Ok(captures::put(&context, file, &name).await?))?;
                say!("{name}: {bytes} bytes")
            }
            Command::Get { name, file } => {
                let bytes = access
                    .with(async |_, context| Ok(captures::get(&context, name, file).await?))?;
                say!("{}: {bytes} bytes", file.display())
            }
        }
    }
}
