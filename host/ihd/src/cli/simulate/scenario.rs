//! The firmware in simulated time with a file of events.

use std::path::Path;

use anyhow::{Context, Result};
use ihd_sim::scenario::file::Scenario;
use ihd_sim::scenario::limits::LimitCheck;
use ihd_sim::scenario::run::run;
use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::output;
use crate::report::scenario as report;

/// Error for limits of the file that the record does not meet, after it was printed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{} of {of} limits missed: {}", missed.len(), missed.join("; "))]
pub struct MissedLimits {
    /// Missed limits, each with value and allowed range.
    pub missed: Vec<String>,
    /// Number of limits.
    pub of: usize,
}

/// Reads and runs the scenario, and prints the report.
///
/// # Errors
/// A file that cannot be read, with line, field and allowed values; a figure that cannot be written; [`MissedLimits`] after the
/// report.
pub(super) fn simulate(file: &Path, plot: Option<&Path>, json: bool) -> Result<()> {
    let path = file.display();
    let scenario = Scenario::read(file).with_context(|| format!("scenario {path}"))?;
    let bar = ProgressBar::new(1000).with_style(ProgressStyle::with_template(
        "simulating {bar:40} {percent:>3} % {eta}",
    )?);
    let record = run(&scenario, |share| bar.set_position((share * 1e3) as u64))
        .with_context(|| format!("scenario {path}"))?;
    bar.finish_and_clear();
    if let Some(plot) = plot {
        report::figure::write(&record, plot)?;
    }
    let checked = scenario.file.limits.check(&record);
    match json {
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
