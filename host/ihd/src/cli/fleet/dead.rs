//! `ihd fleet dead` and `replay`.

use anyhow::Result;
use clap::Args;
use ihd_daemon::config::is_name;
use ihd_fleet::dead_letters::{self, DeadFilter};

use super::{AccessArgs, ago};
use crate::report::table::Table;

/// Windows that were given up, with the reasons
#[derive(Debug, Args)]
pub struct DeadArgs {
    #[command(flatten)]
    which: Which,
    /// Delete them for good
    #[arg(long)]
    delete: bool,
    /// Print JSON
    #[arg(long, conflicts_with = "delete")]
    json: bool,
}

/// Put windows that were given up back into the queue
#[derive(Debug, Args)]
#[command(after_help = "Example: ihd fleet replay --hob bench")]
pub struct ReplayArgs {
    #[command(flatten)]
    which: Which,
}

#[derive(Debug, Args)]
struct Which {
    /// Only windows of this hob
    #[arg(long, value_name = "HOB")]
    hob: Option<String>,
    /// The window of this number, as `ihd fleet dead` shows it
    #[arg(long, value_name = "N")]
    number: Option<u64>,
}

impl Which {
    fn filter(&self) -> Result<DeadFilter> {
        if let Some(hob) = &self.hob {
            ensure_usage!(is_name(hob), "--hob {hob:?}: no hob has such a name");
        }
        Ok(DeadFilter {
            hob: self.hob.clone(),
            number: self.number,
        })
    }
}

impl DeadArgs {
    pub(super) fn run(&self, access: &AccessArgs) -> Result<()> {
        let filter = self.which.filter()?;
        if self.delete {
            let deleted = access
                .with(async |_, context| Ok(dead_letters::delete(&context, &filter).await?))?;
            return say!("{deleted} deleted");
        }
        let windows =
            access.with(async |_, context| Ok(dead_letters::list(&context, &filter).await?))?;
        if self.json {
            return say!("{}", serde_json::to_string_pretty(&windows)?);
        }
        if windows.is_empty() {
            return say!("none was given up");
        }
        let mut table = Table::new(&["number", "hob", "boot", "window", "ago", "worker", "why"]);
        for dead in &windows {
            table.row([
                dead.number.to_string(),
                dead.hob.clone(),
                dead.boot.to_string(),
                dead.seq.to_string(),
                ago(1_000 * dead.at_s),
                dead.by.clone(),
                dead.why.clone(),
            ]);
        }
        say!("{}", table.render().trim_end())
    }
}

impl ReplayArgs {
    pub(super) fn run(&self, access: &AccessArgs) -> Result<()> {
        let filter = self.which.filter()?;
        let replayed =
            access.with(async |_, context| Ok(dead_letters::replay(&context, &filter).await?))?;
        say!("{replayed} back in the queue")
    }
}
