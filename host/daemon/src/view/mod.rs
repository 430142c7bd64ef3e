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
    /// One permit for each query that may run at a time.
    pub(crate) readers: Arc<Semaphore>,
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
        let turn = Arc::clone(&self.readers).acquire_owned().await;
        let folder = self.folder.clone();
        let reading = self.machine.spawn_blocking(move || {
            // The query goes on if its caller leaves, and so does its turn.
            let _turn = turn;
            f(&StoreReader::open(&folder)?)
        });
        let read = reading.await;
        Ok(read.map_err(|_| StoreThreadError::Gone("reading it panicked"))??)
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

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use ihd_store::{Store, StoreOptions};

    use super::*;

    #[tokio::test]
    async fn a_query_keeps_its_turn_when_its_caller_leaves() {
        let folder = tempfile::tempdir().unwrap();
        let opened = Store::open(folder.path(), &StoreOptions::default()).unwrap();
        let view = Arc::new(View {
            machine: Machine::default(),
            devices: Arc::default(),
            telemetry: Arc::default(),
            folder: folder.path().to_owned(),
            readers: Arc::new(Semaphore::new(1)),
            ages: Mutex::default(),
        });
        let (began, begun) = tokio::sync::oneshot::channel();
        let (end, ended) = mpsc::channel::<()>();
        let slow = move |_: &StoreReader| {
            began.send(()).unwrap();
            let _ = ended.recv();
            Ok(())
        };
        let asked = Arc::clone(&view);
        let caller = tokio::spawn(async move { asked.read(slow).await });
        begun.await.unwrap();
        caller.abort();
        assert!(caller.await.unwrap_err().is_cancelled());
        assert_eq!(view.readers.available_permits(), 0);
        drop(end);
        view.read(|_| Ok(())).await.unwrap();
        assert_eq!(view.readers.available_permits(), 1);
        drop(opened);
    }
}
