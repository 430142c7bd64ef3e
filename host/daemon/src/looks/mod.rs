//! What is read for whoever looks: by readers of their own, beside the store's thread, on threads that may wait.

mod history;
mod journal;
mod map;
mod measured;
mod scope;
mod training;

use ihd_store::{Reader, StoreError};

use crate::daemon::{Daemon, DaemonError};
use crate::printable::printable;
use crate::store_thread::StoreTrouble;

pub use map::{Ages, newest};
pub use training::Fits;

/// Readers at once: more wait for their turn.
pub(crate) const READERS: usize = 4;

impl Daemon {
    /// Reads the store.
    async fn read<T: Send + 'static>(
        &self,
        f: impl FnOnce(&Reader) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, DaemonError> {
        // Nobody closes it.
        let turn = self.inner.readers.acquire().await;
        let folder = self.inner.folder.clone();
        let reading = tokio::task::spawn_blocking(move || f(&Reader::open(&folder)?)).await;
        drop(turn);
        Ok(reading.map_err(|_| StoreTrouble::Gone("reading it panicked"))??)
    }

    /// Reads what the store holds of a device, connected or not.
    async fn read_of<T: Send + 'static>(
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
        let found = read.await?;
        found.ok_or_else(|| DaemonError::NoDevice(printable(device)))
    }
}

/// A number for JSON, which has no NaN.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}
