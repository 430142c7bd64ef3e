//! Recordings as tables, for whoever loads them into something else.

use std::fs::File;
use std::io::{BufWriter, Seek};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use ihd_capture::exports::recording::{
    ExportLimits, TableError, half_cycles_csv, recording_npz, samples_csv,
};

/// Largest table, in bytes: half an hour of a hob that heats.
const MOST_BYTES: u64 = 2_000_000_000;

/// Longest that a table may take.
const MADE_WITHIN: Duration = Duration::from_secs(300);

/// Bytes that are gathered before they are written.
const BUFFER: usize = 1 << 17;

/// A table of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// The samples of all windows as CSV, with the window's number.
    Samples,
    /// A line a half-cycle, as CSV.
    HalfCycles,
    /// Everything as arrays, for NumPy.
    Arrays,
}

/// Makes a table of a recording, or of what is on disk of it, until `stop` becomes true. It stands in a file without a name
/// beside the recording, which goes with its last reader: a folder for temporary files may be memory.
///
/// It takes a core for some time: not for a thread that others wait for.
///
/// # Errors
/// [`TableError`]: limits of size and time among them.
pub fn table(recording: &Path, which: Table, stop: &AtomicBool) -> Result<File, TableError> {
    let folder = recording.parent().unwrap_or(Path::new("."));
    let spool = || tempfile::tempfile_in(folder);
    let limits = ExportLimits {
        bytes: MOST_BYTES,
        until: Instant::now() + MADE_WITHIN,
        stop,
    };
    let mut file = spool()?;
    let out = file.try_clone()?;
    let buffered = |out| BufWriter::with_capacity(BUFFER, out);
    match which {
        Table::Samples => samples_csv(recording, buffered(out), &limits)?,
        Table::HalfCycles => half_cycles_csv(recording, buffered(out), &limits)?,
        Table::Arrays => recording_npz(recording, out, &spool, &limits)?,
    }
    file.rewind()?;
    Ok(file)
}
