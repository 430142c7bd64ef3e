//! Manual pages and completions of a command, for a release's archive (host/ihd/examples/pages.rs writes them).

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use clap::{Command, CommandFactory};
use clap_complete::Shell;

use super::Cli;

/// File of each shell's completions.
const SHELLS: [(Shell, &str); 5] = [
    (Shell::Bash, "ihd.bash"),
    (Shell::Zsh, "_ihd"),
    (Shell::Fish, "ihd.fish"),
    (Shell::PowerShell, "ihd.ps1"),
    (Shell::Elvish, "ihd.elv"),
];

/// Description of `ihd` and all its commands.
pub fn command() -> Command {
    Cli::command()
}

/// Writes `man/man1/ihd.1`, a page `ihd-COMMAND.1` for each command, and `completions/` for five shells. Files of the same names are
/// replaced.
///
/// # Errors
/// If a folder or a file cannot be written.
pub fn write(folder: &Path) -> Result<()> {
    let failed = || format!("cannot write pages to {}", folder.display());
    let (pages, completions) = (folder.join("man/man1"), folder.join("completions"));
    fs::create_dir_all(&pages).with_context(failed)?;
    fs::create_dir_all(&completions).with_context(failed)?;
    clap_mangen::generate_to(command(), &pages).with_context(failed)?;
    for (shell, file) in SHELLS {
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut command(), "ihd", &mut script);
        fs::write(completions.join(file), script).with_context(failed)?;
    }
    Ok(())
}
