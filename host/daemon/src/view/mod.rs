//! Read model for API and terminal: queries on read-only connections, on blocking threads.

pub(crate) mod cell_ages;
mod history;
mod journal;
mod map;
mod measurement;
pub(crate) mod recent_fits;
mod scope;
pub(crate) mod stored_lookup;
mod training;

use std::time::Duration;

use ihd_store::{Reader, ResultFilter, StoreError};

use crate::daemon::{Daemon, DaemonError};
use crate::printable::printable;
use crate::store_thread::StoreThreadError;

/// Longest response time of a store that counts as alive.
const STORE_TIMEOUT: Duration = Duration::from_secs(5);

impl Daemon {
    /// Returns `true` if the store responds in time, even with an error.
    pub async fn store_responds(&self) -> bool {
        let one = ResultFilter {
            limit: Some(1),
            ..ResultFilter::default()
        };
        let responding = tokio::time::timeout(STORE_TIMEOUT, self.results(one));
        responding.await.is_ok()
    }

    /// Runs a query on the store.
    async fn read<T: Send + 'static>(
        &self,
        f: impl FnOnce(&Reader) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, DaemonError> {
        // The semaphore is never closed.
        let turn = self.inner.readers.acquire().await;
        let folder = self.inner.folder.clone();
        let reading = tokio::task::spawn_blocking(move || f(&Reader::open(&folder)?)).await;
        drop(turn);
        Ok(reading.map_err(|_| StoreThreadError::Gone("reading it panicked"))??)
    }

    /// Runs a query for one device, connected or not.
    async fn read_device<T: Send + 'static>(
        &self,
        device: &str,
        f: impl FnOnce(&Reader, &str) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, DaemonError> {
        let is_known = self.inner.devices.get(device).is_some();
        let name = device.to_owned();
        let read = self.read(move |reader| {
            let is_known = is_known || reader.devices()?.iter().any(|row| row.name == name);
            is_known.then(|| f(reader, &name)).transpose()
        });
        let answer = read.await?;
        answer.ok_or_else(|| DaemonError::NoDevice(printable(device)))
    }
}

/// Returns a number for JSON, which has no NaN; `None` if it is not finite.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}
