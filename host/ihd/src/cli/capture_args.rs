//! Arguments of every command that takes a capture.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, ValueEnum};
use ihd_capture::channels::{ChannelOptions, ChannelRef};
use ihd_capture::formats::unit::Unit;
use ihd_capture::mcap::{FileLosses, SalvagedCapture};
use ihd_capture::open::salvage_with;
use ihd_capture::{CaptureError, OpenOptions, PartReader};
use ihd_signal::Capture;
use ihd_survey::calibration::Calibration;
use ihd_survey::{Hints, SurveyError};

use super::simulate::quantity::{list, quantity};
use super::{keys, output};

/// Channel whose sign is changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Invert {
    /// Voltage.
    V,
    /// Current.
    I,
}

/// Capture, and how it is read. Formats and detection: docs/captures.md.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Capture")]
pub struct CaptureArgs {
    /// Capture: MCAP, CSV, Tektronix WFM or ISF, LeCroy TRC, MATLAB v5 or NPZ
    file: PathBuf,
    /// File of the same acquisition with the other channel; numbered after the first's
    second: Option<PathBuf>,
    /// How the file is read, where it does not say so itself: channels, columns, probe, units, invert, swap, rate; fsw, mains,
    /// zero-crossing and resonance-capacitance instead of what it shows. `--input help` explains them
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = keys::text::<InputOptions>())]
    input: Vec<String>,
    /// Take skew, gain and offsets out by this file of ihd calibrate
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

/// Reading of a capture as the user states it: keys of `--input`.
#[derive(Clone, Debug, Args)]
pub struct InputOptions {
    /// Voltage and current channel, by number (from 1) or name; else found by unit and name
    #[arg(long, value_name = "V,I", value_parser = pair)]
    channels: Option<[ChannelRef; 2]>,
    /// Time, voltage and current column of a table, by number (from 1) or name; T is - for no time
    #[arg(long, value_name = "T,V,I", value_parser = triple, conflicts_with = "channels")]
    columns: Option<[ChannelRef; 3]>,
    /// Factors: ratio of the voltage probe, ampere per volt of the current probe
    #[arg(long, value_name = "V,I", value_parser = list::<2>)]
    probe: Option<[f64; 2]>,
    /// Units of voltage and current, as in mV,mA, instead of the file's
    #[arg(long, value_name = "V,I", value_parser = units)]
    units: Option<[Unit; 2]>,
    /// Change the sign of the voltage, the current, or both (v,i)
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',')]
    invert: Vec<Invert>,
    /// Exchange voltage and current
    #[arg(long)]
    swap: bool,
    /// Sampling rate in S/s instead of the file's time
    #[arg(long, value_name = "HZ", value_parser = quantity)]
    rate: Option<f64>,
    /// Switching frequency in Hz, instead of the capture's
    #[arg(long, value_name = "HZ", value_parser = quantity)]
    fsw: Option<f64>,
    /// Mains frequency in Hz, instead of the capture's
    #[arg(long, value_name = "HZ", value_parser = quantity)]
    mains: Option<f64>,
    /// Time of a mains zero crossing in s, instead of the capture's
    #[arg(long, value_name = "S", value_parser = quantity)]
    zero_crossing: Option<f64>,
    /// Value of the resonance capacitor in F (1080n): the gains are checked against it
    #[arg(long, value_name = "F", value_parser = quantity)]
    resonance_capacitance: Option<f64>,
}

fn several<const N: usize>(text: &str) -> Result<[ChannelRef; N], String> {
    let all: Vec<_> = text.split(',').map(ChannelRef::parse).collect();
    all.try_into()
        .map_err(|_| format!("`{text}` must be {N} numbers or names with commas between them"))
}

fn pair(text: &str) -> Result<[ChannelRef; 2], String> {
    several(text)
}

fn triple(text: &str) -> Result<[ChannelRef; 3], String> {
    several(text)
}

fn units(text: &str) -> Result<[Unit; 2], String> {
    let both: Option<Vec<Unit>> = text.split(',').map(Unit::parse).collect();
    both.and_then(|units| units.try_into().ok())
        .ok_or_else(|| format!("`{text}` must be two units with a comma between them, as in mV,A"))
}

impl CaptureArgs {
    /// Path of the file, or of the first of two.
    pub fn path(&self) -> &Path {
        &self.file
    }

    /// Path of the file, or of both.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        std::iter::once(self.path()).chain(self.second.as_deref())
    }

    /// Keys of `--input` as they were given.
    pub fn given(&self) -> String {
        self.input.join(",")
    }

    /// Parses the keys of `--input`.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage), naming the key, its value and what is accepted.
    pub fn input(&self) -> Result<InputOptions> {
        let input: InputOptions = keys::parse("--input", &self.input)?;
        for (key, value) in [
            ("rate", input.rate),
            ("resonance-capacitance", input.resonance_capacitance),
        ] {
            ensure_usage!(
                value.is_none_or(|value| value.is_finite() && value > 0.0),
                "--input {key}={}: must be a number above zero",
                value.unwrap_or_default()
            );
        }
        Ok(input)
    }

    /// Converts the arguments to options.
    ///
    /// # Errors
    /// Any error of [`CaptureArgs::input`].
    pub fn options(&self) -> Result<OpenOptions> {
        let input = self.input()?;
        Ok(OpenOptions {
            second: self.second.clone(),
            channels: ChannelOptions {
                channels: input.channels,
                units: input.units,
                probe: input.probe,
                invert_v: input.invert.contains(&Invert::V),
                invert_i: input.invert.contains(&Invert::I),
                swap: input.swap,
            },
            columns: input.columns,
            rate_hz: input.rate,
        })
    }

    /// Opens the capture.
    ///
    /// # Errors
    /// [`ihd_capture::CaptureError`] or [`ihd_survey::calibration::CalibrationFileError`],
    /// naming the file and what to do.
    pub fn open(&self) -> Result<LoadedCapture> {
        self.open_with(&mut |_| ())
    }

    /// Opens the capture; `progress` is called with the share read, from 0 to 1.
    ///
    /// # Errors
    /// Any error of [`CaptureArgs::open`].
    pub fn open_with(&self, progress: &mut dyn FnMut(f64)) -> Result<LoadedCapture> {
        let options = self.options()?;
        let SalvagedCapture {
            mut capture,
            losses,
        } = salvage_with(&self.file, &options, progress)?;
        if capture.is_empty() {
            return Err(CaptureError::NoSamples {
                path: self.file.clone(),
                losses,
            }
            .into());
        }
        if let Some(calibration) = self.calibration()? {
            calibration.apply(&mut capture);
        }
        Ok(LoadedCapture { capture, losses })
    }
}

impl CaptureArgs {
    /// Opens the capture to be read in parts; `progress` is called with the share read where all of it is read at once.
    ///
    /// # Errors
    /// As [`CaptureArgs::open`].
    pub fn open_parts(&self, progress: &mut dyn FnMut(f64)) -> Result<CaptureParts> {
        let reader = PartReader::open(&self.file, &self.options()?, progress)?;
        Ok(CaptureParts {
            path: self.file.clone(),
            reader,
            calibration: self.calibration()?,
            pairs: 0,
            span_s: None,
        })
    }

    /// Calibration of the sensors by the user; its doubts are reported.
    fn calibration(&self) -> Result<Option<Calibration>> {
        let Some(path) = &self.calibration else {
            return Ok(None);
        };
        let calibration = Calibration::read(path)?;
        for doubt in calibration.doubts() {
            output::complain(format_args!("warning: {}: {doubt}", path.display()));
        }
        Ok(Some(calibration))
    }
}

impl InputOptions {
    /// User's specifications for the survey.
    pub fn hints(&self) -> Hints {
        Hints {
            f_sw_hz: self.fsw,
            mains_hz: self.mains,
            zero_crossing_s: self.zero_crossing,
            swapped: self.swap,
            inverted: self.invert.len() == 1,
        }
    }

    /// Value of the resonance capacitor in F.
    pub fn capacitance_f(&self) -> Option<f64> {
        self.resonance_capacitance
    }

    /// Refuses keys that a command has no use for.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage), naming the key.
    pub fn refuse(&self, keys: &[&str]) -> Result<()> {
        let given = [
            ("fsw", self.fsw.is_some()),
            ("mains", self.mains.is_some()),
            ("zero-crossing", self.zero_crossing.is_some()),
            (
                "resonance-capacitance",
                self.resonance_capacitance.is_some(),
            ),
        ];
        for (key, is_given) in given {
            ensure_usage!(
                !is_given || !keys.contains(&key),
                "--input {key}: this command has no use for it"
            );
        }
        Ok(())
    }
}

/// Capture, and the losses of its file.
pub struct LoadedCapture {
    /// Readable part.
    pub capture: Capture,
    losses: FileLosses,
}

/// Error for a file of which a part could not be read; the rest was processed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {losses}; {pairs} pairs of samples were read, {ms:.3} ms from first to last{but}")]
pub struct IncompleteCapture {
    file: String,
    losses: FileLosses,
    pairs: usize,
    ms: f64,
    but: String,
}

impl LoadedCapture {
    /// Description of the losses; `None` for a complete file.
    pub fn incomplete(&self) -> Option<IncompleteCapture> {
        let last = self.capture.time.at(self.capture.len().saturating_sub(1));
        let span = self.capture.time.at(0).zip(last);
        (!self.losses.is_none()).then(|| IncompleteCapture {
            file: self.capture.name.clone(),
            losses: self.losses.clone(),
            pairs: self.capture.len(),
            ms: span.map_or(0.0, |(first, last)| (last - first) * 1e3),
            but: String::new(),
        })
    }

    /// Result of a command that computed `result` from the capture: losses of the file are reported in any case.
    ///
    /// The error of `result`, or [`IncompleteCapture`] if that would be no error, or would only say that the rest is not enough.
    pub fn finish(&self, result: Result<()>) -> Result<()> {
        finished(self.incomplete(), result)
    }
}

fn finished(incomplete: Option<IncompleteCapture>, result: Result<()>) -> Result<()> {
    let Some(incomplete) = incomplete else {
        return result;
    };
    match result {
        Ok(()) => Err(incomplete.into()),
        Err(error) if error.is::<SurveyError>() => Err(IncompleteCapture {
            but: format!("; {error}"),
            ..incomplete
        }
        .into()),
        Err(error) => {
            output::complain(format_args!("warning: {incomplete}"));
            Err(error)
        }
    }
}

/// Capture that is read in parts, and what was read of it.
pub struct CaptureParts {
    path: PathBuf,
    reader: PartReader,
    calibration: Option<Calibration>,
    pairs: usize,
    /// Times of the first and the last pair in seconds.
    span_s: Option<(f64, f64)>,
}

impl CaptureParts {
    /// Returns the next part, calibrated; `None` at the end.
    ///
    /// # Errors
    /// [`CaptureError`]; [`CaptureError::NoSamples`] for a capture without samples.
    pub fn next_part(&mut self) -> Result<Option<Capture>> {
        let Some(mut part) = self.reader.next_part()? else {
            if self.pairs == 0 {
                return Err(CaptureError::NoSamples {
                    path: self.path.clone(),
                    losses: self.reader.losses(),
                }
                .into());
            }
            return Ok(None);
        };
        self.pairs += part.len();
        let (first, last) = (part.time.at(0), part.time.at(part.len() - 1));
        let start = self.span_s.map(|span| span.0).or(first);
        self.span_s = start.zip(last).or(self.span_s);
        if let Some(calibration) = &self.calibration {
            calibration.apply(&mut part);
        }
        Ok(Some(part))
    }

    /// Returns `true` if all parts were taken.
    ///
    /// # Errors
    /// [`CaptureError`] if the file cannot be read.
    pub fn is_at_end(&mut self) -> Result<bool> {
        Ok(self.reader.is_at_end()?)
    }

    /// Share of the capture that was read, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.reader.share()
    }

    /// Description of the losses so far; `None` for a complete file.
    pub fn incomplete(&self) -> Option<IncompleteCapture> {
        let losses = self.reader.losses();
        (!losses.is_none()).then(|| IncompleteCapture {
            file: self.path.display().to_string(),
            losses,
            pairs: self.pairs,
            ms: self
                .span_s
                .map_or(0.0, |(first, last)| (last - first) * 1e3),
            but: String::new(),
        })
    }

    /// Result of a command that computed `result` from the parts, as [`LoadedCapture::finish`].
    pub fn finish(&self, result: Result<()>) -> Result<()> {
        finished(self.incomplete(), result)
    }
}
