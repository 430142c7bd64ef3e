//! Export of captures to files of other programs: CSV, NPZ, Parquet.

pub mod csv;
pub mod npz;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod recording;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use ihd_signal::atomic::Replacement;
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
    write_whole(path, |file| {
        let mut out = BufWriter::with_capacity(1 << 16, file);
        csv::write(capture, &mut out, progress)?;
        out.flush()
    })
}

pub(super) fn write_npz(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    write_whole(path, |file| npz::write(capture, file, progress))
}

#[cfg(feature = "parquet")]
pub(super) fn write_parquet(
    capture: &Capture,
    path: &Path,
    progress: ReadProgress<'_>,
) -> Result<(), ExportError> {
    write_whole(path, |file| parquet::write(capture, file, progress))
}

/// Writes a file that takes its name when it is complete: an incomplete one would be taken for a complete one.
fn write_whole<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    path: &Path,
    write: impl FnOnce(File) -> Result<(), E>,
) -> Result<(), ExportError> {
    let written = Replacement::begin(path).and_then(|(replacement, file)| {
        write(file).map_err(io::Error::other)?;
        replacement.complete()
    });
    written.map_err(|e| ExportError::Write {
        path: path.to_owned(),
        what: e.to_string(),
    })
}

/// Number of samples between two progress reports.
const REPORT_EVERY: usize = 1 << 16;

/// Time of sample `k` in seconds; there is one stamp per sample.
fn time_s(time: &TimeBase, k: usize) -> f64 {
    time.at(k).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk that is full after some bytes costs neither the older file nor leaves a part of the new one.
    #[test]
    fn a_failed_export_leaves_the_older_file_and_no_part_of_the_new_one() {
        let folder = tempfile::tempdir().unwrap();
        let (older, new) = (folder.path().join("a.npz"), folder.path().join("b.npz"));
        std::fs::write(&older, b"old").unwrap();
        for path in [&older, &new] {
            let failed = write_whole(path, |mut file| {
                file.write_all(b"half")?;
                Err(io::Error::from(io::ErrorKind::StorageFull))
            });
            assert!(failed.unwrap_err().to_string().contains("npz"));
        }
        assert_eq!(std::fs::read(&older).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
