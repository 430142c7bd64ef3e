//! Channel of a capture file.

use super::unit::Unit;

/// Channel as its file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct FileChannel {
    /// Name in the file; may be empty.
    pub name: String,
    /// Unit; `None` if the file states none.
    pub unit: Option<Unit>,
    /// Largest magnitude that the channel can show, in [`FileChannel::unit`]; `None` if the file does not state it.
    pub full_scale: Option<f64>,
}
