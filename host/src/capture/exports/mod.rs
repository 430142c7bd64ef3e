//! Captures to files for other programs: CSV, NPZ, Parquet; and to the project's own, MCAP.

pub mod csv;
pub mod npz;
#[cfg(feature = "parquet")]
pub mod parquet;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::mcap::{self, McapFileError};
use super::{Capture, TimeBase};

/// A format to write, told by the file's ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// `.mcap`: everything.
    Mcap,
    /// `.csv`: time, voltage, current.
    Csv,
    /// `.npz`: everything, as arrays.
    Npz,
    /// `.parquet`: time, voltage, current; the rest as metadata. Needs the feature `parquet`.
    Parquet,
}

/// Why a capture was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The ending names no format.
    #[error("{}: the ending must be .mcap, .csv, .npz or .parquet", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
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
        /// What the operating system or the format's library says.
        what: String,
    },
    /// Writing an MCAP failed.
    #[error(transparent)]
    Mcap(#[from] McapFileError),
}

impl ExportFormat {
    /// The format of a file with this name.
    ///
    /// # Errors
    /// [`ExportError::Ending`], or [`ExportError::WithoutParquet`] where that is so.
    pub fn of(path: &Path) -> Result<Self, ExportError> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("mcap") => Ok(Self::Mcap),
            Some("csv") => Ok(Self::Csv),
            Some("npz") => Ok(Self::Npz),
            Some("parquet") if cfg!(feature = "parquet") => Ok(Self::Parquet),
            Some("parquet") => Err(ExportError::WithoutParquet {
                path: path.to_owned(),
            }),
            _ => Err(ExportError::Ending {
                path: path.to_owned(),
            }),
        }
    }
}

/// Writes a capture; a file of that name is replaced. `progress` hears how far it is, from 0 to 1.
///
/// # Errors
/// [`ExportError`]; what was written of the file until then is removed.
pub fn write(
    capture: &Capture,
    path: &Path,
    progress: &mut dyn FnMut(f64),
) -> Result<(), ExportError> {
    let format = ExportFormat::of(path)?;
    let to_file = |written: io::Result<()>| {
        written.map_err(|e| {
            // A partial file would pass for a whole one. That it cannot be removed is of no use here.
            let _ = std::fs::remove_file(path);
            ExportError::Write {
                path: path.to_owned(),
                what: e.to_string(),
            }
        })
    };
    match format {
        ExportFormat::Mcap => Ok(mcap::write(capture, path)?),
        ExportFormat::Csv => to_file(buffered(path, |out| csv::write(capture, out, progress))),
        ExportFormat::Npz => to_file(
            File::create(path)
                .and_then(|file| npz::write(capture, file, progress).map_err(io::Error::other)),
        ),
        #[cfg(feature = "parquet")]
        ExportFormat::Parquet => to_file(
            File::create(path)
                .and_then(|file| parquet::write(capture, file, progress).map_err(io::Error::other)),
        ),
        #[cfg(not(feature = "parquet"))]
        ExportFormat::Parquet => Err(ExportError::WithoutParquet {
            path: path.to_owned(),
        }),
    }
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
