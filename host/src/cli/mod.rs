//! The `ihd` command.

pub mod simulate;

use anyhow::Result;
use clap::{Parser, Subcommand};

/// Identifies an induction hob's load and teaches its controller.
#[derive(Debug, Parser)]
#[command(name = "ihd", version, about)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Simulate(Box<simulate::SimulateArgs>),
}

impl Cli {
    /// Runs the chosen subcommand.
    pub fn run(&self) -> Result<()> {
        match &self.command {
            Command::Simulate(args) => args.run(),
        }
    }
}
