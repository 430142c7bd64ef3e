//! `ihd study`: many captures with truth, many estimators, one table.

mod estimators;
mod hostile;
#[cfg(feature = "pinn")]
mod map;
#[cfg(feature = "pinn")]
mod paper;
#[cfg(feature = "pinn")]
mod pots;
mod temperature;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};

/// Run a study and print its tables.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd study estimators --quick\n  \
    ihd study hostile --short\n  \
    ihd study map --pot ferritic-18\n  \
    ihd study pots --pot ferritic-18\n  \
    ihd study temperature --runs 12\n  \
    ihd study paper --quick --out paper-study")]
pub struct StudyArgs {
    #[command(subcommand)]
    study: Study,
}

#[derive(Debug, Subcommand)]
enum Study {
    Estimators(estimators::EstimatorsArgs),
    Hostile(hostile::HostileArgs),
    #[cfg(feature = "pinn")]
    Map(map::MapArgs),
    #[cfg(feature = "pinn")]
    Paper(paper::PaperArgs),
    #[cfg(feature = "pinn")]
    Pots(pots::PotsArgs),
    Temperature(temperature::TemperatureArgs),
}

impl StudyArgs {
    /// Runs the chosen study.
    pub fn run(&self) -> Result<()> {
        match &self.study {
            Study::Estimators(args) => args.run(),
            Study::Hostile(args) => args.run(),
            #[cfg(feature = "pinn")]
            Study::Map(args) => args.run(),
            #[cfg(feature = "pinn")]
            Study::Paper(args) => args.run(),
            #[cfg(feature = "pinn")]
            Study::Pots(args) => args.run(),
            Study::Temperature(args) => args.run(),
        }
    }
}

/// A bar of so many `things` (in words), which a study moves.
fn bar(count: u64, things: &str) -> Result<ProgressBar> {
    let text = format!("{{bar:40}} {{pos}}/{{len}} {things}, {{eta}} left");
    let style = ProgressStyle::with_template(&text).context("progress bar")?;
    Ok(ProgressBar::new(count).with_style(style))
}
