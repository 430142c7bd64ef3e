//! `ihd-study`: many captures with truth, many estimators, one table.

mod estimators;
mod hostile;
mod map;
mod paper;
mod pots;
mod temperature;

use std::path::Path;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use ihd::cli::output;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::document::write_into;

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

/// Runs a study below a progress bar of `things`.
fn with_bar<T>(things: &str, study: impl FnOnce(&(dyn Fn(usize, usize) + Sync)) -> T) -> Result<T> {
    let bar = bar(1, things)?;
    let results = study(&|done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    Ok(results)
}

/// Writes a section into a document between its marks, if one is given, and prints the results as JSON, if there are any, else the
/// section.
fn publish(
    section: &str,
    docs: Option<&Path>,
    marks: (&str, &str),
    results: Option<&impl Serialize>,
) -> Result<()> {
    if let Some(path) = docs {
        write_into(path, marks, section)?;
    }
    match results {
        Some(results) => output::json(results),
        None => output::text(section),
    }
}

/// Creates a progress bar of `count` `things`.
fn bar(count: u64, things: &str) -> Result<ProgressBar> {
    let text = format!("{{bar:40}} {{pos}}/{{len}} {things}, {{eta}} left");
    let style = ProgressStyle::with_template(&text).context("progress bar")?;
    Ok(ProgressBar::new(count).with_style(style))
}
