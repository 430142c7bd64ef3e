//! Channel of a capture file.

use super::stated_unit::StatedUnit;

/// Channel as its file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct FileChannel {
    /// Name in the file; may be empty.
    pub name: String,
    /// Unit that the file states.
    pub unit: StatedUnit,
    /// Largest magnitude that the channel can show, in [`FileChannel::unit`]; `None` if the file does not state it.
    pub full_scale: Option<f64>,
}
