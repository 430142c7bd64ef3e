//! Choice among the stored lookups of a device.

use ihd_store::{LookupRow, LookupState};

/// Returns the latest lookup of a version, pending ones first: after a reset of the device, versions count from 0 again.
pub fn newest(rows: &[LookupRow], version: u32) -> Option<&LookupRow> {
    let mut newest_first = rows.iter().rev().filter(|row| row.version == version);
    let pending = newest_first
        .clone()
        .find(|row| row.state == LookupState::Pending);
    pending.or_else(|| newest_first.next())
}
