//! `ihd inspect`: contents and defects of a capture.

mod report;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd_capture::lone::{LoneChannel, lone_channel};
use ihd_gate::sensors::calibrate;
use ihd_survey::{Finding, Severity, Survey};

use super::capture_args::{CaptureArgs, LoadedCapture};
use super::global::Global;
use super::output;
use super::sensor_args::SensorArgs;
use crate::report::survey;

/// Show the contents of a capture: channels, rate, switching frequency, mains, noise, and defects.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd inspect capture.csv\n  \
    ihd inspect scope_ch1.isf scope_ch2.isf --plot capture.svg\n  \
    ihd inspect capture.mcap --json | jq '.findings[].message'\n\n\
    Exit codes: 0 fit for identification, 1 cannot be read or has no switching frequency, 2 wrong \
    usage, 7 R and L would be wrong (a finding of severity error), or the file is empty, a cut MCAP or of\n\
    one channel (what could be read is shown)")]
pub struct InspectArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    sensors: SensorArgs,
    /// Draw the capture, two periods, the spectra and the findings to this file (.svg, .pdf or .png)
    #[arg(long, value_name = "FILE", value_parser = output::figure_file)]
    plot: Option<PathBuf>,
}

/// Error for a capture with findings that make R and L wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("R and L of this capture would be wrong: {0} findings of severity error")]
pub struct UnfitCapture(pub usize);

/// Error for a file with one channel, which gives neither R nor L.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0} holds one channel: R and L need the file with the other one too, as in `ihd inspect {0} OTHER`"
)]
pub struct SingleChannel(pub String);

impl InspectArgs {
    /// Opens and surveys the capture, and prints the report.
    ///
    /// # Errors
    /// Any error of the capture's reader or the survey; [`UnfitCapture`] after the report.
    pub fn run(&self, global: &Global) -> Result<()> {
        self.capture.ensure_not_read(self.plot.as_deref())?;
        if let Some(lone) = lone_channel(self.capture.path(), &self.capture.options()?)? {
            return self.single(&lone, global.json);
        }
        let loaded = self.capture.open()?;
        loaded.finish(self.inspect(&loaded, global.json))
    }

    /// Describes a file of one channel; R and L need the other one.
    fn single(&self, lone: &LoneChannel, json: bool) -> Result<()> {
        if json {
            output::json(&report::lone_json(lone))?;
        } else {
            output::text(&report::lone_text(lone))?;
        }
        Err(SingleChannel(self.capture.path().display().to_string()).into())
    }

    fn inspect(&self, loaded: &LoadedCapture, json: bool) -> Result<()> {
        let input = self.capture.input()?;
        let sensors = self.sensors.options(&input);
        let survey = Survey::from_capture(&loaded.capture, &input.hints())?;
        let calibrated = calibrate(&loaded.capture, survey, &input.hints(), sensors)?;
        let remarks = calibrated.remarks();
        let (capture, survey) = (calibrated.capture.as_ref(), &calibrated.survey);
        let incomplete = loaded.incomplete().map(|what| what.to_string());
        if json {
            output::json(&report::json(&calibrated, &remarks, incomplete))?;
        } else {
            output::text(&report::text(capture, survey, &remarks))?;
        }
        if let Some(path) = &self.plot {
            survey::write(capture, survey, path)?;
        }
        let is_error = |f: &&Finding| f.severity() == Severity::Error;
        match survey.findings.iter().filter(is_error).count() {
            0 => Ok(()),
            errors => Err(UnfitCapture(errors).into()),
        }
    }
}
