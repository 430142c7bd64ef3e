//! What all targets do with a file whose header was accepted.

use ihd_capture::error::FormatError;
use ihd_capture::formats::Source;

/// Reads the first two channels: every sample must be finite, and columns of one length.
pub fn drain(opened: Result<impl Source, FormatError>) {
    let Ok(mut source) = opened else { return };
    // A table may hold nothing beside its time.
    let Some(second) = source.channels().len().min(2).checked_sub(1) else {
        return;
    };
    let wanted = [0, second];
    if let Ok(samples) = source.read(&wanted, &mut |_| ()) {
        let length = samples.columns[0].len();
        for column in &samples.columns {
            assert_eq!(column.len(), length);
            assert!(column.iter().all(|x| x.is_finite()));
        }
    }
}
