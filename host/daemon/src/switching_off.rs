//! Switching a device off, ahead of all other requests on its link.

use std::sync::Arc;

use ihd_link::{AsyncClient, LinkError};

use crate::device_record::DeviceRecord;

/// Switches the device off, repeated once without an answer, and records it in the lease before any other request to the device.
///
/// # Errors
/// Error of the link.
pub async fn switch_off(record: &Arc<DeviceRecord>, client: &AsyncClient) -> Result<(), LinkError> {
    let written = || {
        let record = Arc::clone(record);
        move || record.lock().lease.confirm_off()
    };
    match client.off(written()).await {
        Err(LinkError::NoAnswer { .. }) => client.off(written()).await,
        off => off,
    }
}
