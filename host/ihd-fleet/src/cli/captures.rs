//! `ihd-fleet capture`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd::cli::global::Global;
use ihd::report::table::TextTable;
use ihd::say;
use ihd_fleet::captures;

use super::{AccessArgs, ago};

/// Captures in the fleet: list them, put one there, get one
#[derive(Debug, Args)]
#[command(
    after_help = "Example: ihd-fleet capture get lab-1/bench-2026-11-23T08-00-00Z.mcap bench.mcap"
)]
pub struct FleetCaptureArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List the captures
    Ls,
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

impl FleetCaptureArgs {
    /// Returns `true` if the command has JSON to print.
    pub(super) fn prints_json(&self) -> bool {
        matches!(self.command, Command::Ls)
    }

    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        match &self.command {
            Command::Ls => {
                let stored = access.with(global, async |_, context| {
                    Ok(captures::list(&context).await?)
                })?;
                if global.json {
                    return say!("{}", serde_json::to_string_pretty(&stored)?);
                }
                let mut table = TextTable::new(&["capture", "bytes", "ago"]);
                for capture in &stored {
                    let at = capture.at_s.map_or(String::new(), |at_s| ago(1_000 * at_s));
                    table.row([capture.name.clone(), capture.bytes.to_string(), at]);
                }
                say!("{}", table.render().trim_end())
            }
            Command::Put { file, name } => {
                let own = file.file_name().map(|n| n.to_string_lossy().into_owned());
                let name = name.clone().or(own);
                let name = name.with_context(|| format!("{} names no file", file.display()))?;
                let bytes = access.with(global, async |_, context| {
                    Ok(captures::put(&context, file, &name).await?)
                })?;
                say!("{name}: {bytes} bytes")
            }
            Command::Get { name, file } => {
                let bytes = access.with(global, async |_, context| {
                    Ok(captures::get(&context, name, file).await?)
                })?;
                say!("{}: {bytes} bytes", file.display())
            }
        }
    }
}
