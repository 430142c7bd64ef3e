//! `ihd completions`: completion scripts for shells.

use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Cli, output};

/// Print a shell's completions.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd completions bash > ~/.local/share/bash-completion/completions/ihd\n  \
    ihd completions zsh > ~/.zfunc/_ihd          (with ~/.zfunc in fpath, before compinit)\n  \
    ihd completions fish > ~/.config/fish/completions/ihd.fish\n  \
    ihd completions powershell >> $PROFILE\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage")]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

impl CompletionsArgs {
    /// Prints the script.
    ///
    /// # Errors
    /// If standard output cannot be written.
    pub fn run(&self) -> Result<()> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "ihd", &mut script);
        output::text(&String::from_utf8_lossy(&script))
    }
}
