//! The `ihd` command.

use clap::Parser;

fn main() -> anyhow::Result<()> {
    ihd::cli::Cli::parse().run()
}
