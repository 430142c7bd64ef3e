//! `ihd scenario`: the firmware in simulated time with a file of events.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use ihd_sim::scenario::file::Scenario;
use ihd_sim::scenario::limits::LimitCheck;
use ihd_sim::scenario::run::run;
use indicatif::{ProgressBar, ProgressStyle};

use super::output;
use crate::report::scenario as report;

/// Run the firmware in simulated time against a file of events: power, pots, mains, faults.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd scenario lift.toml\n  \
    ihd scenario lift.toml --json | jq .summary\n  \
    ihd scenario lift.toml --plot lift.svg\n\n\
A file (docs/control.md has every field):\n  \
    duration_s = 3.0\n  \
    load = \"reduced\"                  # behavioural, reduced or field\n  \
    mains = { v_rms = 230.0, hz = 50.0 }\n  \
    pot = { name = \"ferritic-21\", lift_mm = 0.0, offset_mm = 0.0 }\n  \
    [[event]]\n  \
    at_s = 0.0\n  \
    power_w = 1500\n  \
    [[event]]\n  \
    at_s = 1.0\n  \
    pot = { name = \"ferritic-21\", lift_mm = 20.0, for_s = 0.3 }\n  \
    [[event]]\n  \
    at_s = 2.0\n  \
    mains = { v_rms = 138.0, for_s = 0.2 }\n\n\
Exit codes: 0 it ran and met the [limits] of its file, if there are any, 1 the file cannot be read or run, 2 wrong\n\
usage, 7 a limit is missed")]
pub struct ScenarioArgs {
    /// The scenario
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Print every half-cycle, fault and the summary as one JSON object
    #[arg(long)]
    json: bool,
    /// Draw power, frequency, crests and states over time to this file (SVG)
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
}

/// Error for limits of the file that the record does not meet, after it was printed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{} of {of} limits missed: {}", missed.len(), missed.join("; "))]
pub struct MissedLimits {
    /// Missed limits, each with value and allowed range.
    pub missed: Vec<String>,
    /// Number of limits.
    pub of: usize,
}

impl ScenarioArgs {
    /// Reads and runs the scenario, and prints the report.
    ///
    /// # Errors
    /// A file that cannot be read, with line, field and allowed values; a figure that cannot be written; [`MissedLimits`] after the
    /// report.
    pub fn run(&self) -> Result<()> {
        let path = self.file.display();
        let scenario = Scenario::read(&self.file).with_context(|| format!("scenario {path}"))?;
        let bar = ProgressBar::new(1000).with_style(ProgressStyle::with_template(
            "simulating {bar:40} {percent:>3} % {eta}",
        )?);
        let record = run(&scenario, |share| bar.set_position((share * 1e3) as u64))
            .with_context(|| format!("scenario {path}"))?;
        bar.finish_and_clear();
        if let Some(plot) = &self.plot {
            report::figure::write(&record, plot)?;
        }
        let checked = scenario.file.limits.check(&record);
        match self.json {
            true => output::json_line(&record)?,
            false => output::text(&report::text(&record, &checked))?,
        }
        let missed = checked.iter().filter(|c| !c.ok).map(LimitCheck::to_string);
        let missed: Vec<String> = missed.collect();
        match missed.is_empty() {
            true => Ok(()),
            false => Err(MissedLimits {
                missed,
                of: checked.len(),
            }
            .into()),
        }
    }
}
