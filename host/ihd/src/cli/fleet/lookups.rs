//! `ihd fleet lookups`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd_fleet::lookups::{self, LookupEntry};
use ihd_shared::lookup::RlLookup;

use super::{AccessArgs, ago};
use crate::report::table::Table;

/// Lookups in the fleet: the present one of each hob, its history, and one to be used
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd fleet lookups ls\n  \
    ihd fleet lookups history bench\n  \
    ihd fleet lookups rollback bench 4711")]
pub struct LookupsArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The latest of each hob
    Ls {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Those of one hob, oldest first
    History {
        /// The hob
        hob: String,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Have a hob use a lookup of a file (lookup-vN.bin of `ihd trainer`)
    Push {
        /// The hob
        hob: String,
        /// The file
        file: PathBuf,
    },
    /// Have a hob use one of its history again
    Rollback {
        /// The hob
        hob: String,
        /// Its revision, as `history` shows it
        revision: u64,
    },
}

impl LookupsArgs {
    pub(super) fn run(&self, access: &AccessArgs) -> Result<()> {
        let me = format!("operator-{}", std::env::var("USER").unwrap_or_default());
        match &self.command {
            Command::Ls { json } => {
                let entries = access.with(async |_, context| Ok(lookups::all(&context).await?))?;
                show(&entries, *json)
            }
            Command::History { hob, json } => {
                let entries =
                    access.with(async |_, context| Ok(lookups::history(&context, hob).await?))?;
                show(&entries, *json)
            }
            Command::Push { file, hob } => {
                let lookup = RlLookup::from_bytes(&crate::cli::device::lookup::read(file)?)?;
                let put = access.with(async |_, context| {
                    Ok(lookups::request(&context, hob, &lookup, &me).await?)
                })?;
                say!("{hob} is to use it: revision {put}; its edge pushes it")
            }
            Command::Rollback { hob, revision } => {
                let put = access.with(async |_, context| {
                    let history = lookups::history(&context, hob).await?;
                    let earlier = history.iter().find(|entry| entry.revision == *revision);
                    let earlier = earlier.with_context(|| {
                        format!("{hob} has no revision {revision}: ihd fleet lookups history {hob}")
                    })?;
                    let blob = earlier.lookup.blob().map_err(anyhow::Error::msg)?;
                    let lookup = RlLookup::from_bytes(&blob)?;
                    Ok(lookups::request(&context, hob, &lookup, &me).await?)
                })?;
                say!("{hob} is to use it again: revision {put}; its edge pushes it")
            }
        }
    }
}

fn show(entries: &[LookupEntry], json: bool) -> Result<()> {
    if json {
        return say!("{}", serde_json::to_string_pretty(entries)?);
    }
    let mut table = Table::new(&["hob", "revision", "version", "by", "", "ago"]);
    for entry in entries {
        let lookup = &entry.lookup;
        let used = if lookup.in_use { "in use" } else { "wanted" };
        table.row([
            entry.hob.clone(),
            entry.revision.to_string(),
            lookup.version.to_string(),
            lookup.by.clone(),
            used.to_owned(),
            ago(lookup.at_ms),
        ]);
    }
    say!("{}", table.render().trim_end())
}
