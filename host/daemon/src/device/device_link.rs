//! Link of a session: requests to the device, each of them a contact.

use std::sync::Arc;

use ihd_link::{AsyncClient, Client, LinkError};

use super::contact::Contact;

/// Link to a connected device.
pub struct DeviceLink {
    /// Client of the connection.
    pub client: Arc<AsyncClient>,
    /// Contact with the device.
    pub contact: Contact,
}

impl DeviceLink {
    /// Runs a request on the link.
    ///
    /// # Errors
    /// Error of the link or of the request.
    pub async fn request<T: Send + 'static>(
        &mut self,
        f: impl FnOnce(&mut Client) -> Result<T, LinkError> + Send + 'static,
    ) -> Result<T, LinkError> {
        self.contact.on_request();
        self.client.with(f).await?
    }
}
