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
use ihd_capture::recording::MIN_FREE_BYTES;

use super::files::free_bytes;

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
/// [`RecordingExportError`], among them the limits of size, room and time.
pub fn table(
    recording: &Path,
    which: RecordingTable,
    stop: &AtomicBool,
) -> Result<(File, FileLosses), RecordingExportError> {
    let folder = recording.parent().unwrap_or(Path::new("."));
    let spool = || tempfile::tempfile_in(folder);
    let limits = ExportLimits {
        bytes: limit_bytes(free_bytes(folder)).ok_or(RecordingExportError::NoRoom)?,
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

/// Returns the size limit of a table on a disk with this many free bytes, if they are known; `None` if there is no room for one.
fn limit_bytes(free: Option<u64>) -> Option<u64> {
    let room = free.map_or(MAX_BYTES, |free| free.saturating_sub(MIN_FREE_BYTES));
    (room > 0).then_some(room.min(MAX_BYTES))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_leaves_the_room_that_recordings_leave() {
        assert_eq!(limit_bytes(None), Some(MAX_BYTES));
        assert_eq!(limit_bytes(Some(u64::MAX)), Some(MAX_BYTES));
        assert_eq!(limit_bytes(Some(MIN_FREE_BYTES + 7)), Some(7));
        for free in [MIN_FREE_BYTES, 0] {
            assert_eq!(limit_bytes(Some(free)), None);
        }
    }
}
