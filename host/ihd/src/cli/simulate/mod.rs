//! `ihd simulate`: recording of the simulated power stage with its truth, or a scenario of the whole firmware.

mod event;
pub mod quantity;
mod report;
pub mod scenario;
mod spec;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use ihd_sim::recording::{file, run};
use indicatif::{ProgressBar, ProgressStyle};

use self::spec::SpecOptions;
use crate::cli::global::Global;
use crate::cli::keys;
use crate::cli::output;
use crate::cli::recording_file;
use crate::cli::usage::Usage;
use crate::report::recording;

/// Load models on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LoadWord {
    /// Electromagnetic field model, in time.
    Field,
    /// Table fitted to the field model, its surrogate.
    #[value(name = "reduced", alias = "surrogate")]
    Surrogate,
    /// Closed formulas for R and L.
    Behavioural,
}

impl From<LoadWord> for LoadKind {
    fn from(word: LoadWord) -> Self {
        match word {
            LoadWord::Field => Self::Field,
            LoadWord::Surrogate => Self::Surrogate,
            LoadWord::Behavioural => Self::Behavioural,
        }
    }
}

/// Simulate coil voltage and current of a hob, with the truth about R and L; or run the firmware against a file of events.
///
/// Numbers take SI prefixes: 45k, 50M, 20ms, 0.2us. What is not given comes from the preset. A scenario is the whole firmware in
/// simulated time: power, pots, mains, faults.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
        ihd simulate --plot waveforms.svg\n  \
        ihd simulate paper-50 --set pot=ferritic-18,snr=30,rate=50M --out half-cycle.mcap\n  \
        ihd simulate --set load=behavioural,rate=locked,at=5ms:pot=none\n  \
        ihd simulate lift.toml --json | jq .summary\n  \
        ihd simulate lift.toml --plot lift.svg\n\n\
A scenario's file (docs/control.md has every field):\n  \
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
pub struct SimulateArgs {
    /// Operating point of the paper to start from: paper-45, paper-50, paper-60 or paper-70; or a scenario's file
    #[arg(value_name = "FILE.toml|PRESET", default_value = "paper-45")]
    what: String,
    /// Change a value of the preset: fsw, sweep, duty, mains, pot, lift, load, rate, bits, snr, at and more; `--set help` explains
    /// them. May be given again
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = keys::text::<SpecOptions>())]
    set: Vec<String>,
    /// Seed of noise and spikes
    #[arg(long)]
    seed: Option<u64>,
    /// Write the recording to this file (MCAP, docs/captures.md)
    #[arg(long, short, value_parser = recording_file::parse)]
    out: Option<PathBuf>,
    /// Write the waveforms without noise and quantising too
    #[arg(long, requires = "out")]
    clean: bool,
    /// Draw waveforms, R and L to this file (.svg, .pdf or .png)
    #[arg(long, value_parser = output::figure_file)]
    plot: Option<PathBuf>,
    /// List the cost of each approximation of the field model, and do nothing else
    #[arg(long)]
    approximations: bool,
}

impl SimulateArgs {
    /// Converts the arguments to a specification.
    pub fn settings(&self) -> Result<CaptureSpec> {
        let mut s = CaptureSpec::preset(&self.what).map_err(Usage::from_error)?;
        keys::parse::<SpecOptions>("--set", &self.set)?.apply(&mut s);
        s.seed = self.seed.unwrap_or(s.seed);
        s.check().map_err(Usage::from_error)?;
        s.pot.check().map_err(Usage::from_error)?;
        Ok(s)
    }

    /// File of the scenario; `None` for a preset.
    fn scenario(&self) -> Option<&Path> {
        self.what
            .contains(['.', '/', '\\'])
            .then(|| Path::new(&self.what))
    }

    /// Simulates, writes the requested files and prints a summary.
    pub fn run(&self, global: &Global) -> Result<()> {
        if let Some(file) = self.scenario() {
            ensure_usage!(
                self.out.is_none()
                    && self.seed.is_none()
                    && self.set.is_empty()
                    && !self.approximations,
                "a scenario's file says all of it: only --plot and --json go with {}",
                file.display()
            );
            return scenario::simulate(file, self.plot.as_deref(), global.json);
        }
        ensure_usage!(
            !global.json,
            "--json goes with a scenario: ihd simulate FILE.toml --json"
        );
        if self.approximations {
            return report::approximations();
        }
        let settings = self.settings()?;
        let bar = ProgressBar::new(1000);
        let style = ProgressStyle::with_template("{bar:40} {percent:>3} %  {eta} left");
        bar.set_style(style.context("progress bar")?);
        let started = Instant::now();
        let recording = run::record(&settings, |share| bar.set_position((share * 1000.0) as u64))?;
        bar.finish_and_clear();
        let took = started.elapsed();
        report::summary(&recording, took)?;
        if let Some(path) = &self.out {
            file::write(&recording, path, self.clean)?;
            say!("recording  {}", path.display())?;
        }
        if let Some(path) = &self.plot {
            recording::write(&recording, path)?;
            say!("figure     {}", path.display())?;
        }
        Ok(())
    }
}
