//! Export of captures to files of other programs: CSV, NPZ, Parquet.

pub mod csv;
pub mod npz;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod recording;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use ihd_signal::{Capture, TimeBase};

use super::formats::ReadProgress;
use super::mcap::McapFileError;

/// Error of writing a capture.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The file's ending names no format.
    #[error("{}: the ending must be one of {known}", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
        /// Endings of the formats that can be written.
        known: String,
    },
    /// This build has no Parquet.
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
        /// Error of the operating system or of the format's library.
        what: String,
    },
    /// Writing an MCAP failed.
    #[error(transparent)]
    Mcap(#[from] McapFileError),
}

pub(super) fn write_csv(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    remove_if_failed(
        path,
        buffered(path, |out| csv::write(capture, out, progress)),
    )
}

pub(super) fn write_npz(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    write_new_file(path, |file| npz::write(capture, file, progress))
}

#[cfg(feature = "parquet")]
pub(super) fn write_parquet(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    write_new_file(path, |file| parquet::write(capture, file, progress))
}

/// Writes a new file at this path.
fn write_new_file<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    path: &Path,
    write: impl FnOnce(File) -> Result<(), E>,
) -> Result<(), ExportError> {
    let written = File::create(path).and_then(|file| write(file).map_err(io::Error::other));
    remove_if_failed(path, written)
}

/// Removes the file if writing failed: an incomplete file would be taken for a complete one.
fn remove_if_failed(path: &Path, written: io::Result<()>) -> Result<(), ExportError> {
    written.map_err(|e| {
        // An error of the removal changes nothing.
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

/// Number of samples between two progress reports.
const REPORT_EVERY: usize = 1 << 16;

/// Time of sample `k` in seconds; there is one stamp per sample.
fn time_s(time: &TimeBase, k: usize) -> f64 {
    time.at(k).unwrap_or(f64::NAN)
}
