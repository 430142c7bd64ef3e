//! Windows that were given up: `ihd-fleet status dead` and `ihd-fleet retry`.

use anyhow::{Result, bail};
use clap::Args;
use ihd::cli::global::Global;
use ihd::report::table::TextTable;
use ihd::{ensure_usage, say};
use ihd_daemon::config::is_name;
use ihd_fleet::dead_letters::{self, DeadFilter};

use super::{AccessArgs, ago};

/// Put windows that were given up back into the queue
#[derive(Debug, Args)]
#[command(after_help = "Example: ihd-fleet retry --hob bench")]
pub struct RetryArgs {
    #[command(flatten)]
    which: DeadWindowArgs,
}

#[derive(Debug, Args)]
pub(super) struct DeadWindowArgs {
    /// Only windows of this hob
    #[arg(long, value_name = "HOB")]
    hob: Option<String>,
    /// The window of this number, as `ihd-fleet status dead` shows it
    #[arg(long, value_name = "N")]
    number: Option<u64>,
}

impl DeadWindowArgs {
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

impl DeadWindowArgs {
    /// Refuses a number that no window given up has.
    fn ensure_found(&self, windows: u64) -> Result<()> {
        match self.number {
            Some(number) if windows == 0 => {
                bail!("no window {number} was given up: ihd-fleet status dead")
            }
            _ => Ok(()),
        }
    }

    /// Returns `true` if some windows alone are named.
    pub(super) fn is_given(&self) -> bool {
        self.hob.is_some() || self.number.is_some()
    }

    /// Shows the windows, or deletes them for good.
    pub(super) fn show(&self, delete: bool, access: &AccessArgs, global: &Global) -> Result<()> {
        let filter = self.filter()?;
        if delete {
            let deleted = access.with(global, async |_, context| {
                Ok(dead_letters::delete(&context, &filter).await?)
            })?;
            self.ensure_found(deleted)?;
            return say!("{deleted} deleted");
        }
        let windows = access.with(global, async |_, context| {
            Ok(dead_letters::list(&context, &filter).await?)
        })?;
        if global.json {
            return say!("{}", serde_json::to_string_pretty(&windows)?);
        }
        if windows.is_empty() {
            return say!("none was given up");
        }
        let mut table =
            TextTable::new(&["number", "hob", "boot", "window", "ago", "worker", "why"]);
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

impl RetryArgs {
    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let filter = self.which.filter()?;
        let replayed = access.with(global, async |_, context| {
            Ok(dead_letters::replay(&context, &filter).await?)
        })?;
        self.which.ensure_found(replayed)?;
        say!("{replayed} back in the queue")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_no_window_has_is_an_error_and_an_empty_list_is_none() {
        let found = |number, windows| {
            let which = DeadWindowArgs { hob: None, number };
            which.ensure_found(windows).is_ok()
        };
        assert!(found(None, 0) && found(None, 2) && found(Some(7), 1));
        assert!(!found(Some(7), 0));
    }
}
