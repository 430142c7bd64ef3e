//! `ihd inspect`: what is in a capture, and what is wrong with it.

mod report;

use std::io::Write;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd_survey::{Finding, Severity, Survey};

use super::capture_args::CaptureArgs;
use super::hint_args::HintArgs;
use crate::report::survey;

/// Show what is in a capture: channels, rate, switching frequency, mains, noise, and what is wrong.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd inspect capture.csv\n  \
    ihd inspect scope_ch1.isf scope_ch2.isf --plot capture.svg\n  \
    ihd inspect capture.mcap --json | jq '.findings[].message'\n\n\
    Exit codes: 0 fit for identification, 1 cannot be read or has no switching frequency, 2 wrong \
    usage, 7 R and L would be wrong (a finding of severity error)")]
pub struct InspectArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    hints: HintArgs,
    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,
    /// Draw the capture, two periods, the spectra and the findings to this file (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// The capture has findings that make R and L wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("R and L of this capture would be wrong: {0} findings of severity error")]
pub struct UnfitCapture(pub usize);

impl InspectArgs {
    /// Opens, surveys, reports.
    ///
    /// # Errors
    /// What the capture's reader or the survey reports; [`UnfitCapture`] after the report.
    pub fn run(&self) -> Result<()> {
        let capture = self.capture.open()?;
        let survey = Survey::of(&capture, &self.hints.hints())?;
        let text = if self.json {
            serde_json::to_string_pretty(&report::json(&survey))? + "\n"
        } else {
            report::text(&capture, &survey)
        };
        std::io::stdout().write_all(text.as_bytes())?;
        if let Some(path) = &self.plot {
            survey::write(&capture, &survey, path)?;
        }
        let is_error = |f: &&Finding| f.severity() == Severity::Error;
        match survey.findings.iter().filter(is_error).count() {
            0 => Ok(()),
            errors => Err(UnfitCapture(errors).into()),
        }
    }
}
