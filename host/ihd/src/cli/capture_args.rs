//! Arguments of every command that takes a capture.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use ihd_capture::mcap::{FileLosses, SalvagedCapture};
use ihd_capture::open::salvage_with;
use ihd_capture::{CaptureError, OpenOptions, PartReader};
use ihd_signal::Capture;
use ihd_survey::SurveyError;
use ihd_survey::calibration::{Calibration, METADATA_KEY, transformer};

use super::input_options::InputOptions;
use super::usage::Usage;
use super::{keys, output};

/// Capture, and how it is read. Formats and detection: docs/captures.md.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Capture")]
pub struct CaptureArgs {
    /// Capture: MCAP, CSV, Tektronix WFM or ISF, LeCroy TRC, MATLAB v5 or NPZ
    file: PathBuf,
    /// File of the same acquisition with the other channel; numbered after the first's
    second: Option<PathBuf>,
    /// Reading of the file, where it does not say so itself: channels, columns, probe, units, invert, swap, rate; fsw, mains,
    /// zero-crossing and resonance-capacitance instead of what it shows. `--input help` explains them
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = keys::text::<InputOptions>())]
    input: Vec<String>,
    /// Take skew, gain and offsets out by this file of ihd calibrate
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
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
        keys::parse("--input", &self.input)
    }

    /// Converts the arguments to options.
    ///
    /// # Errors
    /// Any error of [`CaptureArgs::input`].
    pub fn options(&self) -> Result<OpenOptions> {
        Ok(self.input()?.open_options(self.second.clone()))
    }

    /// Refuses an output that is also what is read.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage), naming the file.
    pub fn ensure_not_read<'a>(&self, outs: impl IntoIterator<Item = &'a Path>) -> Result<()> {
        for out in outs {
            let mut read = self.paths().chain(self.calibration.as_deref());
            ensure_usage!(
                !read.any(|input| is_same_file(input, out)),
                "{} is also what is read: give the output another name",
                out.display()
            );
        }
        Ok(())
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
        self.load(progress, &transformer::equalise)
    }

    /// Opens the capture as it was sampled, with the droop of a board's current transformer.
    ///
    /// # Errors
    /// Any error of [`CaptureArgs::open`].
    pub fn open_as_sampled(&self) -> Result<LoadedCapture> {
        self.load(&mut |_| (), &|_| ())
    }

    fn load(
        &self,
        progress: &mut dyn FnMut(f64),
        prepare: &dyn Fn(&mut Capture),
    ) -> Result<LoadedCapture> {
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
        prepare(&mut capture);
        if let Some(calibration) = self.calibration()? {
            apply(&calibration, &mut capture)?;
        }
        Ok(LoadedCapture { capture, losses })
    }
}

impl CaptureArgs {
    /// Opens the capture to be read in parts; `progress` is called with the share read where all of it is read at once.
    ///
    /// # Errors
    /// Any error of [`CaptureArgs::open`].
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

/// Returns `true` if both names are of one file, by a link too.
fn is_same_file(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let identity = |path: &Path| std::fs::metadata(path).ok().map(|m| (m.dev(), m.ino()));
        identity(a).is_some_and(|of_a| identity(b) == Some(of_a))
    }
    #[cfg(not(unix))]
    {
        let name = |path: &Path| path.canonicalize().ok();
        name(a).is_some_and(|of_a| name(b) == Some(of_a))
    }
}

/// Applies a calibration of the user to a capture that has none.
fn apply(calibration: &Calibration, capture: &mut Capture) -> Result<()> {
    if let Some(own) = capture.metadata.get(METADATA_KEY) {
        let name = &capture.name;
        return Err(Usage(format!(
            "{name} is calibrated already ({own}): leave --calibration out, or give the capture as it was recorded"
        ))
        .into());
    }
    calibration.apply(capture);
    Ok(())
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
        transformer::equalise(&mut part);
        if let Some(calibration) = &self.calibration {
            apply(calibration, &mut part)?;
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
