//! Captures to files for other programs: CSV, NPZ, Parquet.

pub mod csv;
pub mod npz;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod recording;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use ihd_signal::{Capture, TimeBase};

use super::formats::Progress;
use super::mcap::McapFileError;

/// Why a capture was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The ending names no format.
    #[error("{}: the ending must be one of {known}", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
        /// The endings that do.
        known: String,
    },
    /// Parquet is not compiled in.
    #[error("{}: this ihd was built without Parquet; build it with --features parquet", path.display())]
    WithoutParquet {
        /// The file.
        path: PathBuf,
    },
    /// Writing failed.
    #[error("{}: {what}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system or the format's library reports.
        what: String,
    },
    /// Writing an MCAP failed.
    #[error(transparent)]
    Mcap(#[from] McapFileError),
}

pub(super) fn write_csv(
    capture: &Capture,
    path: &Path,
    progress: Progress<'_>,
) -> Result<(), ExportError> {
    whole(
        path,
        buffered(path, |out| csv::write(capture, out, progress)),
    )
}

pub(super) fn write_npz(
    capture: &Capture,
    path: &Path,
    progress: Progress<'_>,
) -> Result<(), ExportError> {
    created(path, |file| npz::write(capture, file, progress))
}

#[cfg(feature = "parquet")]
pub(super) fn write_parquet(
    capture: &Capture,
    path: &Path,
    progress: Progress<'_>,
) -> Result<(), ExportError> {
    created(path, |file| parquet::write(capture, file, progress))
}

/// Writes into a new file of that name.
fn created<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    path: &Path,
    write: impl FnOnce(File) -> Result<(), E>,
) -> Result<(), ExportError> {
    let written = File::create(path).and_then(|file| write(file).map_err(io::Error::other));
    whole(path, written)
}

/// Removes what was written of a file when it failed: a part would pass for the whole.
fn whole(path: &Path, written: io::Result<()>) -> Result<(), ExportError> {
    written.map_err(|e| {
        // That it cannot be removed either is of no use here.
        let _ = std::fs::remove_file(path);
        ExportError::Write {
            path: path.to_owned(),
            what: e.to_string(),
        }
    })
}

fn buffered(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 16, File::create(path)?);
    write(&mut out)?;
    out.flush()
}

/// Samples between two reports of progress.
const REPORT_EVERY: usize = 1 << 16;

/// Time of sample `k`; stamps are as many as samples.
fn time_s(time: &TimeBase, k: usize) -> f64 {
    time.at(k).unwrap_or(f64::NAN)
}
