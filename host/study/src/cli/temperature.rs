//! `ihd-study temperature`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;

use crate::document::write_into;
use crate::temperature::closed_loop::{self, ClosedLoopResult};
use crate::temperature::table::{self, TemperatureSums};
use crate::temperature::{TemperaturePlan, TemperatureRun, figure, study};
use ihd::cli::output;

/// Follow the temperature of pots that are cooked with, and find their boil; and try to make it see one that is none.
///
/// Cooks from tables of the field model with the noise of the firmware's filter: pots of 15 to 21 cm, 0.5 to 3 litre, 800 to 2200 W, lift of 0 to 1 mm
/// that is not known, moves, pots that differ from what physics predicts; as many runs that must not boil. All of it with the alloy's
/// coefficients as known, with each pot's off by up to 20 %, and with these after the pot has boiled water three times.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study temperature --runs 12\n  \
    ihd-study temperature --closed-loop --docs docs/map.md --plot docs/pot-temperature.svg")]
pub struct TemperatureArgs {
    /// Runs that boil, and as many that do not
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    runs: u64,
    /// First seed; the same seed gives the same digits
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// One boil with the firmware itself, too: some minutes
    #[arg(long)]
    closed_loop: bool,
    /// Print the runs as JSON
    #[arg(long)]
    json: bool,
    /// Write the tables into this document, between its marks
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
    /// Draw two runs
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
}

/// Spread of the alloys' coefficients in the second part of the study.
const ALLOY: f64 = 0.2;

/// Parts of the study: spread of the alloys, and boils of water in the same pot before.
const SETS: [(&str, f64, u64); 3] = [
    ("alloy known", 0.0, 0),
    ("alloy off by up to 20 %", ALLOY, 0),
    ("the same after three boils", ALLOY, 3),
];

/// Results as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    sets: Vec<Set<'a>>,
    closed_loop: Option<&'a ClosedLoopResult>,
}

/// Runs with one spread of alloys.
#[derive(Serialize)]
struct Set<'a> {
    name: &'a str,
    sum: TemperatureSums,
    runs: &'a [TemperatureRun],
}

impl TemperatureArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        let bar = super::bar(2 * SETS.len() as u64 * self.runs, "runs")?;
        let mut sets = Vec::new();
        for (name, alloy, lessons) in SETS {
            let plan = TemperaturePlan {
                runs: self.runs,
                seed: self.seed,
                alloy,
                lessons,
            };
            let before = bar.position();
            let runs = study(&plan, &|done, _| bar.set_position(before + done as u64))?;
            bar.set_position(before + 2 * self.runs);
            sets.push((name.to_owned(), runs));
        }
        bar.finish_and_clear();
        let outcome = match self.closed_loop {
            true => {
                let bar = ProgressBar::new_spinner();
                let outcome =
                    closed_loop::run(&|t_s| bar.set_message(format!("{t_s:.0} s of the hob")));
                bar.finish_and_clear();
                Some(outcome?)
            }
            false => None,
        };
        let mut section = table::markdown(&sets);
        if let Some(outcome) = &outcome {
            section += "\n";
            section += &outcome.text();
        }
        if let Some(path) = &self.docs {
            write_into(path, (table::BEGIN, table::END), &section)?;
        }
        if let Some(path) = &self.plot {
            figure::write(path)?;
        }
        if !self.json {
            return output::text(&section);
        }
        let of = |(name, runs): &'_ (String, Vec<TemperatureRun>)| {
            (name.clone(), TemperatureSums::summarise(runs))
        };
        let sums: Vec<(String, TemperatureSums)> = sets.iter().map(of).collect();
        output::json(&Answer {
            sets: sums
                .iter()
                .zip(&sets)
                .map(|((name, sum), (_, runs))| Set {
                    name,
                    sum: sum.clone(),
                    runs,
                })
                .collect(),
            closed_loop: outcome.as_ref(),
        })
    }
}
