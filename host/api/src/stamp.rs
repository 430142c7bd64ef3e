//! Time of change and length of a file, by which a changed one is noticed.

use std::path::Path;
use std::time::SystemTime;

/// Time of change and length.
pub(crate) type Stamp = (SystemTime, u64);

/// Returns the stamp of a file; `None` if it cannot be read.
pub(crate) fn stamp(path: &Path) -> Option<Stamp> {
    let about = std::fs::metadata(path).ok()?;
    Some((about.modified().ok()?, about.len()))
}
