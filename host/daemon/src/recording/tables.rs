//! Export of recordings as tables.

use std::fs::File;
use std::io::{BufWriter, Seek};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use ihd_capture::exports::recording::{
    ExportLimits, RecordingExportError, half_cycles_csv, recording_npz, samples_csv,
};
use ihd_capture::mcap::FileLosses;

/// Largest table, in bytes: half an hour of a heating hob.
const MAX_BYTES: u64 = 2_000_000_000;

/// Time limit for an export.
pub const EXPORT_TIMEOUT: Duration = Duration::from_secs(300);

/// Size of the write buffer, in bytes.
const BUFFER: usize = 1 << 17;

/// Table of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingTable {
    /// Samples of all windows as CSV, with the window's number.
    Samples,
    /// One line per half-cycle, as CSV.
    HalfCycles,
    /// All data as NumPy arrays.
    Arrays,
}

/// Exports a recording, also an incomplete one, as a table. The table is an unnamed file in the recording's folder (the folder for
/// temporary files may be memory), deleted with its last reader. Returns it with what of the recording was lost.
///
/// Blocks and uses one core for up to minutes. Ends early once `stop` is `true`.
///
/// # Errors
/// [`RecordingExportError`], among them the limits of size and time.
pub fn table(
    recording: &Path,
    which: RecordingTable,
    stop: &AtomicBool,
) -> Result<(File, FileLosses), RecordingExportError> {
    let folder = recording.parent().unwrap_or(Path::new("."));
    let spool = || tempfile::tempfile_in(folder);
    let limits = ExportLimits {
        bytes: MAX_BYTES,
        until: Instant::now() + EXPORT_TIMEOUT,
        stop,
    };
    let mut file = spool()?;
    let out = file.try_clone()?;
    let buffered = |out| BufWriter::with_capacity(BUFFER, out);
    let losses = match which {
        RecordingTable::Samples => samples_csv(recording, buffered(out), &limits)?,
        RecordingTable::HalfCycles => half_cycles_csv(recording, buffered(out), &limits)?,
        RecordingTable::Arrays => recording_npz(recording, out, &spool, &limits)?,
    };
    file.rewind()?;
    Ok((file, losses))
}
