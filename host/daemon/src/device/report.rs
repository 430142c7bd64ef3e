//! Reports about a device without its session.

use ihd_model::CommandError;

use crate::device_record::DeviceRecord;

/// Returns the error of a command to a device that is not connected.
pub fn not_connected_error(record: &DeviceRecord) -> CommandError {
    let asked_w = record.lock().lease.asked_w();
    let mut detail = record.detail();
    if asked_w > 0 {
        detail += "; what was asked of it ends by itself within 10 s";
    }
    CommandError::NotConnected {
        name: record.name.clone(),
        detail,
    }
}

/// Logs and publishes that a lease has expired.
pub(super) fn publish_lease_expired(record: &DeviceRecord, holder: &str) {
    tracing::info!(device = record.name, holder, "the lease has run out");
    record.publish_lease_end("it has run out".to_owned());
}
