//! `ihd man`: manual pages.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, CommandFactory};

use super::Cli;

/// Write the manual pages: ihd.1, and one a subcommand, ihd-SUBCOMMAND.1.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd man --out man1 && man -l man1/ihd-doctor.1\n  \
    sudo ihd man --out /usr/local/share/man/man1\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage")]
pub struct ManArgs {
    /// Folder of the pages; it is created if missing, and pages of the same names are replaced
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
}

impl ManArgs {
    /// Writes the pages.
    ///
    /// # Errors
    /// If the folder or a page cannot be written.
    pub fn run(&self) -> Result<()> {
        let failed = || format!("cannot write manual pages to {}", self.out.display());
        fs::create_dir_all(&self.out).with_context(failed)?;
        clap_mangen::generate_to(Cli::command(), &self.out).with_context(failed)
    }
}
