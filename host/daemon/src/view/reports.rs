//! Reports of devices, live values, rows of the store.

use std::sync::Arc;

use ihd_model::{DeviceReport, PotCurve};
use ihd_store::{LookupRow, ResultFilter, ResultRow};

use super::View;
use crate::error::DaemonError;
use crate::live::LiveTap;
use crate::printable::printable;

impl View {
    /// Returns the daemon's clock, in milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        self.machine.now_ms()
    }

    /// Returns a tap of the devices' telemetry, polled at the rate of its reader.
    pub fn live(&self) -> LiveTap {
        LiveTap::new(Arc::clone(&self.devices), self.machine.clone())
    }

    /// Returns the reports of all devices, sorted by name.
    pub fn devices(&self) -> Vec<DeviceReport> {
        let all = self.devices.all();
        all.iter().map(|handle| handle.record.report()).collect()
    }

    /// Returns the report of a device; `None` if it is unknown.
    pub fn device(&self, name: &str) -> Option<DeviceReport> {
        Some(self.devices.get(name)?.record.report())
    }

    /// Returns the temperature curve of a device's pot over the last hour; `None` if the device is unknown.
    pub fn pot_curve(&self, name: &str) -> Option<PotCurve> {
        let handle = self.devices.get(name)?;
        let mut curve = handle.record.pot_curve().clone();
        let (state, _) = handle.record.state_and_age();
        curve.now = curve.now.filter(|_| state.is_heard());
        Some(curve)
    }

    /// Returns results, newest first.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn results(&self, filter: ResultFilter) -> Result<Vec<ResultRow>, DaemonError> {
        self.read(move |reader| reader.results(&filter)).await
    }

    /// Returns the active lookup of a device in the store; `None` for the built-in one.
    ///
    /// # Errors
    /// Error of the store.
    pub async fn active_lookup(&self, device: &str) -> Result<Option<LookupRow>, DaemonError> {
        let device = device.to_owned();
        self.read(move |reader| reader.lookup(&device, None)).await
    }

    /// Returns the lookups of a device, oldest first: the active one, the pending one and the newest others.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn lookups(&self, device: &str) -> Result<Vec<LookupRow>, DaemonError> {
        if self.devices.get(device).is_none() {
            return Err(DaemonError::NoDevice(printable(device)));
        }
        let device = device.to_owned();
        self.read(move |reader| reader.lookups_of(&device)).await
    }
}
