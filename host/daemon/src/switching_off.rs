//! Switching a device off: on a lane of its own, whatever its task and its link are at.

use std::sync::Arc;

use ihd_link::{AsyncClient, LinkError};

use crate::face::Face;

/// Switches the device off, once more where no answer came, and writes it down before anything else is asked of the device.
///
/// # Errors
/// What the link reports.
pub async fn switch_off(face: &Arc<Face>, client: &AsyncClient) -> Result<(), LinkError> {
    let written = || {
        let face = Arc::clone(face);
        move || face.lock().lease.switched_off()
    };
    match client.off(written()).await {
        Err(LinkError::NoAnswer { .. }) => client.off(written()).await,
        off => off,
    }
}
