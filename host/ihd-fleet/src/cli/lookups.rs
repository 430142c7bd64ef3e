//! `ihd-fleet lookup`.

use std::path::Path;

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd::cli::global::Global;
use ihd::report::table::TextTable;
use ihd::say;
use ihd_fleet::lookups::{self, LookupEntry};
use ihd_shared::lookup::RlLookup;

use super::{AccessArgs, ago};

/// Lookups in the fleet: the present one of each hob, its history, and one to be used
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-fleet lookup ls\n  \
    ihd-fleet lookup ls bench\n  \
    ihd-fleet lookup push bench 4711")]
pub struct LookupArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The latest of each hob, or those of one, oldest first
    Ls {
        /// The hob whose history is wanted
        hob: Option<String>,
    },
    /// Have a hob use a lookup of a file, or one of its history again
    Push {
        /// The hob
        hob: String,
        /// The file (lookup-vN.bin of `ihd trainer`), or a revision, as `ls HOB` shows it
        #[arg(value_name = "FILE|REVISION")]
        lookup: String,
    },
}

impl LookupArgs {
    /// Returns `true` if the command has JSON to print.
    pub(super) fn prints_json(&self) -> bool {
        matches!(self.command, Command::Ls { .. })
    }

    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let me = format!("operator-{}", std::env::var("USER").unwrap_or_default());
        match &self.command {
            Command::Ls { hob } => {
                let found = access.with(global, async |_, context| match hob {
                    None => Ok(lookups::all(&context).await?),
                    Some(hob) => Ok(lookups::history(&context, hob).await?),
                })?;
                show(&found, global.json)
            }
            Command::Push { hob, lookup } => match lookup.parse() {
                Ok(revision) => again(hob, revision, &me, access, global),
                Err(_) => from_file(hob, Path::new(lookup), &me, access, global),
            },
        }
    }
}

/// Has a hob use the lookup of a file.
fn from_file(hob: &str, file: &Path, me: &str, access: &AccessArgs, global: &Global) -> Result<()> {
    let lookup = RlLookup::from_bytes(&ihd::cli::device::lookup::read(file)?)?;
    let put = access.with(global, async |_, context| {
        Ok(lookups::request(&context, hob, &lookup, me).await?)
    })?;
    say!(
        "{hob} is to use it: revision {put}; its edge pushes it within a day, or refuses it: ihd-fleet lookup ls {hob}"
    )
}

/// Has a hob use a lookup of its history.
fn again(hob: &str, revision: u64, me: &str, access: &AccessArgs, global: &Global) -> Result<()> {
    let put = access.with(global, async |_, context| {
        let history = lookups::history(&context, hob).await?;
        let wanted = history.iter().find(|entry| entry.revision == revision);
        let wanted = wanted.with_context(|| {
            format!("{hob} has no revision {revision}: ihd-fleet lookup ls {hob}")
        })?;
        let lookup = wanted.lookup.decode().map_err(anyhow::Error::msg)?;
        Ok(lookups::request(&context, hob, &lookup, me).await?)
    })?;
    say!(
        "{hob} is to use it again: revision {put}; its edge pushes it within a day, or refuses it: ihd-fleet lookup ls {hob}"
    )
}

fn show(entries: &[LookupEntry], json: bool) -> Result<()> {
    if json {
        return say!("{}", serde_json::to_string_pretty(entries)?);
    }
    let mut table = TextTable::new(&["hob", "revision", "version", "by", "", "ago"]);
    for entry in entries {
        let lookup = &entry.lookup;
        let used = match &lookup.refused {
            Some(why) => format!("refused: {why}"),
            None if lookup.in_use => "in use".to_owned(),
            None => "wanted".to_owned(),
        };
        table.row([
            entry.hob.clone(),
            entry.revision.to_string(),
            lookup.version.to_string(),
            lookup.by.clone(),
            used,
            ago(lookup.at_ms),
        ]);
    }
    say!("{}", table.render().trim_end())
}
