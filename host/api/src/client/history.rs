//! History of a device.

use ihd_model::History;

use super::{ApiClient, ClientError, device};

impl ApiClient {
    /// Returns telemetry of a device's last `last_ms` milliseconds in at most `columns` columns.
    ///
    /// # Errors
    /// [`ClientError`]; [`ClientError::Refused`] if the daemon is too old for this request.
    pub fn history(&self, name: &str, last_ms: u32, columns: u32) -> Result<History, ClientError> {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let to_ms = now.map_or(0, |now| now.as_millis() as i64);
        let from_ms = to_ms - i64::from(last_ms);
        let query = format!("/history?from={from_ms}&to={to_ms}&columns={columns}");
        self.get(&device(name, &query))
    }
}
