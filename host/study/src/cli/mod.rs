//! `ihd-study`: many captures with truth, many estimators, one table.

mod estimators;
mod hostile;
mod map;
mod paper;
mod pots;
mod temperature;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};

/// Studies of ihd: many captures with truth, many estimators, one table each.
#[derive(Debug, Parser)]
#[command(
    name = "ihd-study",
    version,
    after_help = "Examples:\n  \
    ihd-study estimators --quick\n  \
    ihd-study hostile --short\n  \
    ihd-study map --pot ferritic-18\n  \
    ihd-study pots --pot ferritic-18\n  \
    ihd-study temperature --runs 12\n  \
    ihd-study paper --quick --out paper-study"
)]
pub struct Cli {
    #[command(subcommand)]
    study: Study,
}

#[derive(Debug, Subcommand)]
enum Study {
    Estimators(estimators::EstimatorsArgs),
    Hostile(hostile::HostileArgs),
    Map(map::MapArgs),
    Paper(paper::PaperArgs),
    Pots(pots::PotsArgs),
    Temperature(temperature::TemperatureArgs),
}

impl Cli {
    /// Runs the chosen study.
    ///
    /// # Errors
    /// Whatever ends it early, with its context.
    pub fn run(&self) -> Result<()> {
        match &self.study {
            Study::Estimators(args) => args.run(),
            Study::Hostile(args) => args.run(),
            Study::Map(args) => args.run(),
            Study::Paper(args) => args.run(),
            Study::Pots(args) => args.run(),
            Study::Temperature(args) => args.run(),
        }
    }
}

/// Creates a progress bar of `count` `things`.
fn bar(count: u64, things: &str) -> Result<ProgressBar> {
    let text = format!("{{bar:40}} {{pos}}/{{len}} {things}, {{eta}} left");
    let style = ProgressStyle::with_template(&text).context("progress bar")?;
    Ok(ProgressBar::new(count).with_style(style))
}
