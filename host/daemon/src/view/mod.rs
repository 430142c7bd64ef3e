//! Read model for API and terminal: queries on read-only connections, on blocking threads.

pub(crate) mod cell_ages;
mod history;
mod journal;
mod map;
mod measurement;
pub(crate) mod recent_fits;
mod recordings;
mod reports;
mod scope;
pub(crate) mod stored_lookup;
mod training;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use ihd_store::{StoreError, StoreReader};
use tokio::sync::Semaphore;

use self::cell_ages::CellAges;
pub use self::recordings::Recordings;
use crate::error::DaemonError;
use crate::history::TelemetryBuffer;
use crate::machine::Machine;
use crate::printable::printable;
use crate::store_thread::StoreThreadError;
use crate::supervisor::Devices;

/// Read model of the daemon.
pub struct View {
    pub(crate) machine: Machine,
    pub(crate) devices: Arc<Devices>,
    /// Telemetry that is not stored yet.
    pub(crate) telemetry: Arc<TelemetryBuffer>,
    /// Folder of the store, for readers.
    pub(crate) folder: PathBuf,
    pub(crate) readers: Semaphore,
    /// Ages of the lookup cells, by device.
    pub(crate) ages: Mutex<BTreeMap<String, CellAges>>,
}

impl View {
    /// Runs a query on the store.
    async fn read<T: Send + 'static>(
        &self,
        f: impl FnOnce(&StoreReader) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, DaemonError> {
        // The semaphore is never closed.
        let turn = self.readers.acquire().await;
        let folder = self.folder.clone();
        let reading = tokio::task::spawn_blocking(move || f(&StoreReader::open(&folder)?)).await;
        drop(turn);
        Ok(reading.map_err(|_| StoreThreadError::Gone("reading it panicked"))??)
    }

    /// Runs a query for one device, connected or not.
    async fn read_device<T: Send + 'static>(
        &self,
        device: &str,
        f: impl FnOnce(&StoreReader, &str) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, DaemonError> {
        let is_known = self.devices.get(device).is_some();
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
